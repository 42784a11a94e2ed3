"""Nonlinear least squares by a trust region on column-scaled variables.

Minimises |r(z)|^2. With D the column norms of the Jacobian (largest seen so far), each step
solves

    min |J d + r|   subject to   |D d| <= Delta

through the SVD of J D^-1 (Moré, "The Levenberg-Marquardt algorithm: implementation and
theory", 1978). A step is taken only when it lowers the cost, so the iteration cannot
diverge. Directions whose singular value is at rounding level are left where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
State = TypeVar("State")

_ROUNDING = 1e-11  # singular values below this fraction of the largest carry no information


class Status(Enum):
    """Why an estimate stopped; the value is the remedy in words."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "stopped at the iteration limit while still improving; start nearer, or identify fewer parameters"
    NO_PROGRESS = "no step improves the fit although it is not at a minimum; check units, signs and the order of channels"
    DOES_NOT_CLOSE = "the loop cannot be closed at the starting values; check the nominal geometry, offsets and channel signs"
    UNEXPLAINED = "the mechanism as described does not explain the readings; check gains, signs, units, the order of channels and the fixture"
    OUTLYING = "a few poses contradict all the others; leave them out or record them again"
    FAR_FROM_NOMINAL = "the answer lies implausibly far from the nominal values: on another assembly, or a nominal value is wrong; give values nearer to the truth, or sense more joints"
    UNDETERMINED = (
        "the poses determine none of the parameters; record poses that differ more, in every joint"
    )

    @property
    def word(self) -> str:
        """Name for result files."""
        return self.name.lower().replace("_", "-")


@dataclass(frozen=True, slots=True)
class Evaluation(Generic[State]):
    """Residual (M,), Jacobian (M, n), and whatever makes the next evaluation cheaper."""

    residual: Array
    jacobian: Array
    state: State


@dataclass(frozen=True, slots=True)
class Minimum(Generic[State]):
    """Where the iteration ended.

    Attributes:
        variables: (n,).
        last: evaluation there.
        status: why it stopped.
        iterations: accepted and rejected steps.
    """

    variables: Array
    last: Evaluation[State]
    status: Status
    iterations: int


def minimise(
    evaluate: Callable[[Array, State | None], Evaluation[State] | None],
    start: Array,
    *,
    iterations: int = 100,
    tolerance: float = 1e-9,
    floor: float = 1e-10,
) -> Minimum[State] | None:
    """A local minimum of |r(z)|^2 from ``start``; None when r cannot be evaluated there.

    Args:
        evaluate: residual and Jacobian at z, given the state of the best point so far; None
            where z is not admissible.
        start: (n,).
        iterations: steps at most.
        tolerance: stop when a step would lower the cost by less than this fraction, or
            moves less than this fraction of the scaled variables.
        floor: a cost gain that is nothing. Whitened residuals have unit variance.
    """
    z = start.copy()
    here = evaluate(z, None)
    if here is None:
        return None
    cost = float(here.residual @ here.residual)
    scale = _norms(here.jacobian)
    radius = 0.0
    for iteration in range(1, iterations + 1):
        scale = np.maximum(scale, _norms(here.jacobian))
        left, singular, right = _svd(here, scale)
        full = _step(left, singular, right, np.inf)
        if radius == 0.0:
            radius = max(10 * float(np.linalg.norm(full)), 1e-12)
        predicted = cost - _cost_after(left, singular, right, cost, full)
        if predicted <= tolerance * cost + floor:
            return Minimum(z, here, Status.CONVERGED, iteration)
        while True:
            step = _step(left, singular, right, radius)
            predicted = cost - _cost_after(left, singular, right, cost, step)
            there = evaluate(z + step / scale, here.state)
            after = np.inf if there is None else float(there.residual @ there.residual)
            gain = (cost - after) / predicted if predicted > 0 else 0.0
            length = float(np.linalg.norm(step))
            if gain < 0.25:
                radius = 0.25 * length
            elif gain > 0.75 and length > 0.9 * radius:
                radius *= 2.0
            if there is not None and gain > 1e-4:
                small = cost - after <= tolerance * cost and length <= 1e-3 * float(
                    np.linalg.norm(z * scale)
                )
                z, here, cost = z + step / scale, there, after
                if small:
                    return Minimum(z, here, Status.CONVERGED, iteration)
                break
            if predicted <= 1e-7 * cost or length <= 1e-13 * float(np.linalg.norm(z * scale)):
                at_floor = predicted <= 1e-7 * cost
                return Minimum(
                    z, here, Status.CONVERGED if at_floor else Status.NO_PROGRESS, iteration
                )
    return Minimum(z, here, Status.ITERATION_LIMIT, iterations)


def _norms(jacobian: Array) -> Array:
    norms = np.linalg.norm(jacobian, axis=0)
    return np.where(norms > 0, norms, 1.0)


def _svd(here: Evaluation[State], scale: Array) -> tuple[Array, Array, Array]:
    """(U' r, singular values, V') of the scaled Jacobian, rounding-level directions removed."""
    stacked = np.column_stack([here.jacobian / scale, here.residual])
    triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    left, singular, right = np.linalg.svd(triangle[:, :-1], full_matrices=False)
    kept = singular > _ROUNDING * singular[:1].sum()
    return (left.T @ triangle[:, -1])[kept], singular[kept], right[kept]


def _step(left: Array, singular: Array, right: Array, radius: float) -> Array:
    """The scaled step: Gauss-Newton, or damped until it is ``radius`` long."""
    if not np.linalg.norm(left / singular) > radius:
        return -right.T @ (left / singular)
    low, high = 0.0, float(np.linalg.norm(left * singular)) / radius
    for _ in range(60):
        damping = 0.5 * (low + high)
        length = np.linalg.norm(left * singular / (singular**2 + damping))
        low, high = (damping, high) if length > radius else (low, damping)
        if abs(length - radius) < 0.01 * radius:
            break
    return -right.T @ (left * singular / (singular**2 + damping))


def _cost_after(left: Array, singular: Array, right: Array, cost: float, step: Array) -> float:
    """Cost that the linear model predicts after ``step``."""
    along = singular * (right @ step)
    return cost + float(2 * left @ along + along @ along)
