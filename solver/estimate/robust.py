"""Robust losses: poses that noise cannot explain are weighed down, whole poses at a time.

The sum of squared whitened residuals of a pose, s, would be chi-square with d degrees of
freedom (its redundancy) were the parameters known. The fit itself takes up the pose's
leverage h, the trace of its block of the hat matrix, so that s / (d - h) is 1 on average: a
pose that the others cannot check is not mistaken for a good one. With t the root of that,
over the poses' own robust scale where it exceeds 1,

    huber    w = min(1, c / t)            cauchy    w = 1 / (1 + (t / c)^2)

and c keeps the textbook's chance of 1.345 (Huber) or 2.385 (Cauchy) for one degree of
freedom, 95 % efficiency (Holland & Welsch, "Robust regression using iteratively reweighted
least-squares", 1977). A weight scales all of a pose's residuals, so its true coordinates
are the same with and without. No loss can judge a pose that alone shows some combination of
parameters: its leverage takes up all of its redundancy.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

Array = NDArray[np.float64]

DOWNWEIGHTED = 0.5
"""A weight below this is worth telling: noise alone gives a fitting pose such a weight very rarely."""

_QUANTILES = 2000
_FOLLOWING = 8  # rounds in which leverage and scale follow the weights
_ROUNDS = 100
_SETTLED = 3e-4  # a change of weights that is none
_ROUNDING = 1e-11  # of the normal matrix with unit columns


class Loss(Enum):
    """How much a pose far from the model counts."""

    NONE = "none"
    HUBER = "huber"
    CAUCHY = "cauchy"

    def weight(self, t: Array, freedoms: int) -> Array:
        """Weights in (0, 1] of normalised distances ``t`` with ``freedoms`` degrees of freedom."""
        if self is Loss.NONE:
            return np.ones_like(t)
        tuning = 1.345 if self is Loss.HUBER else 2.385
        c = np.sqrt(chdtri(freedoms, chdtrc(1, tuning**2)) / freedoms)
        if self is Loss.HUBER:
            return np.asarray(np.minimum(1.0, c / np.maximum(t, 1e-300)), dtype=np.float64)
        return np.asarray(1.0 / (1.0 + (t / c) ** 2), dtype=np.float64)

    def expected(self, freedoms: int) -> float:
        """Mean of w t^2 when there is nothing but noise: what a weighted misfit is divided by."""
        if self is Loss.NONE:
            return 1.0
        square = chdtri(freedoms, (np.arange(_QUANTILES) + 0.5) / _QUANTILES) / freedoms
        return float(np.mean(self.weight(np.sqrt(square), freedoms) * square))


def yardstick(residual: Array, jacobian: Array, used: Array, freedoms: int) -> Array:
    """(P,) squared residuals that count as usual for each pose: its redundancy left times the poses' scale.

    Args:
        residual: (P, C) at a fit, whitened, unweighted.
        jacobian: (P, C, n), likewise.
        used: (P,) weights of the fit.
        freedoms: redundancy of a pose.
    """
    poses, channels, count = jacobian.shape
    scaled = jacobian * np.sqrt(used)[:, None, None]
    flat = scaled.reshape(-1, count)
    norms = np.linalg.norm(flat, axis=0)
    basis = np.linalg.qr(flat / np.where(norms > 0, norms, 1.0))[0]
    leverage = np.sum(basis.reshape(poses, channels, -1) ** 2, axis=(1, 2))
    left = np.maximum(freedoms - leverage, 0.05 * freedoms)
    square = np.sum(residual**2, axis=1) / left
    spread = np.median(square) / (chdtri(freedoms, 0.5) / freedoms)
    return np.asarray(left * max(float(spread), 1.0))


def reweighted(
    loss: Loss,
    residual: Array,
    jacobian: Array,
    beside: tuple[Array, Array],
    used: Array,
    freedoms: int,
    usual: Array | None = None,
) -> tuple[Array, Array]:
    """Weights (P,) at which refitting would settle, were the model linear about a fit, and their yardstick (P,).

    Leverage and scale follow the weights for a few rounds and are then kept: left to follow
    for ever they chase the weights and nothing settles, while with a fixed yardstick every
    round lowers the loss. Residuals do not notice a step along what the data leave open.

    Args:
        loss: which.
        residual: (P, C) at the fit, whitened, unweighted.
        jacobian: (P, C, n), likewise.
        beside: residual (M,) and Jacobian (M, n) of all that is not a pose: priors, known distances.
        used: (P,) weights of the fit.
        freedoms: redundancy of a pose.
        usual: the yardstick to keep; found where None.
    """
    poses, channels, count = jacobian.shape
    flat = jacobian.reshape(-1, count)
    norms = np.linalg.norm(np.vstack([flat, beside[1]]), axis=0)
    scale = 1.0 / np.where(norms > 0, norms, 1.0)
    flat, other = flat * scale, beside[1] * scale
    weight, moved = used, residual
    following = 0 if usual is not None else _FOLLOWING
    for turn in range(_ROUNDS):
        if usual is None or turn < following:
            usual = yardstick(moved, jacobian, weight, freedoms)
        renewed = loss.weight(np.sqrt(np.sum(moved**2, axis=1) / usual), freedoms)
        settled = turn >= following and float(np.abs(renewed - weight).max()) < _SETTLED
        weight = renewed
        if settled:
            break
        each = np.repeat(weight, channels)
        normal = (flat * each[:, None]).T @ flat + other.T @ other
        slope = flat.T @ (each * residual.ravel()) + other.T @ beside[0]
        step = -np.linalg.lstsq(normal, slope, rcond=_ROUNDING)[0]
        moved = residual + (flat @ step).reshape(poses, channels)
    assert usual is not None
    return weight, usual
