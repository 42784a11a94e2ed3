"""Gauss-Newton with column scaling, as both papers use it, and what sensor noise does to its result.

Each step solves J H d = -f in the least-squares sense with H = diag(1 / |column|)
(Nahvi, Hollerbach & Hayward, equations 7 and 8), then x moves by H d. A step that raises
the cost is halved. The residual f is not whitened: the covariance of the result comes from
propagating the reading noise through f, cov = J+ S J+', with S block-diagonal over poses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.trust_region import Status

Array = NDArray[np.float64]

_HALVINGS = 30


@dataclass(frozen=True, slots=True)
class Closure:
    """A paper's residual at P poses, E equations a pose.

    Attributes:
        residual: (P, E), zero where the loops close.
        by_parameters: (P, E, n).
        by_readings: (P, E, C) [per count].
    """

    residual: Array
    by_parameters: Array
    by_readings: Array

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.residual**2))

    @property
    def jacobian(self) -> Array:
        """(P * E, n)."""
        return self.by_parameters.reshape(-1, self.by_parameters.shape[2])

    def spread(self, sigma: Array) -> Array:
        """(P, E, E) covariance of the residual under reading noise ``sigma`` (P, C) [counts]."""
        scaled = self.by_readings * sigma[:, None, :]
        return scaled @ np.swapaxes(scaled, 1, 2)


def solve(
    evaluate: Callable[[Array], Closure | None],
    start: Array,
    *,
    iterations: int = 100,
    tolerance: float = 1e-10,
) -> tuple[Array, Closure, Status, int] | None:
    """Minimise the sum of squares from ``start`` (n,); None where the residual does not exist there."""
    z = start.copy()
    here = evaluate(z)
    if here is None:
        return None
    for iteration in range(1, iterations + 1):
        step = gauss_newton_step(here)
        gained = here.cost - float(np.sum((here.residual.ravel() + here.jacobian @ step) ** 2))
        if gained <= tolerance * here.cost:
            return z, here, Status.CONVERGED, iteration
        for _ in range(_HALVINGS):
            there = evaluate(z + step)
            if there is not None and there.cost < here.cost:
                break
            step = 0.5 * step
        else:
            return z, here, Status.NO_PROGRESS, iteration
        z, here = z + step, there
    return z, here, Status.ITERATION_LIMIT, iterations


def gauss_newton_step(closure: Closure) -> Array:
    """(n,) least-squares step of the column-scaled linear problem."""
    jacobian = closure.jacobian
    norms = np.linalg.norm(jacobian, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    step: Array = (
        -np.linalg.lstsq(jacobian / norms, closure.residual.ravel(), rcond=1e-12)[0] / norms
    )
    return step


def propagate(closure: Closure, sigma: Array) -> Array:
    """(n, n) covariance of the least-squares solution under reading noise ``sigma`` (P, C) [counts]."""
    poses, equations, count = closure.by_parameters.shape
    jacobian = closure.jacobian
    norms = np.linalg.norm(jacobian, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    inverse = (np.linalg.pinv(jacobian / norms, rcond=1e-12) / norms[:, None]).reshape(
        count, poses, equations
    )
    scaled = np.einsum("npe,pec->npc", inverse, closure.by_readings * sigma[:, None, :]).reshape(
        count, -1
    )
    covariance: Array = scaled @ scaled.T
    return covariance


def expected_cost(closure: Closure, sigma: Array) -> float:
    """Sum of squares that reading noise alone leaves after the fit: trace of (I - J J+) S.

    Unlike a whitened sum it stays meaningful when the equations of a pose share one
    redundant measurement, so that S is singular.
    """
    poses, equations, count = closure.by_parameters.shape
    norms = np.linalg.norm(closure.jacobian, axis=0)
    basis = np.linalg.qr(closure.jacobian / np.where(norms > 0, norms, 1.0))[0].reshape(
        poses, equations, count
    )
    spread = closure.spread(sigma)
    absorbed = np.einsum("pen,pef,pfn->", basis, spread, basis)
    return float(np.trace(spread, axis1=1, axis2=2).sum() - absorbed)
