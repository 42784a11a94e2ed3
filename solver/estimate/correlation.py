"""Whether poses that are alike leave residuals that are alike, and how much wider intervals must be for it.

Noise is independent from pose to pose; what a model lacks is not: it varies smoothly with the
configuration. With w the P x r redundant parts of the whitened residuals and K the kernel
k(i, j) = exp(-d^2 / 2 l^2), d the distance between readings in units of their own spread,

    w' K w - c w' w,    c = tr(K R) / tr R

is 0 on average when there is nothing but noise, R = I - J cov J' being what a fit leaves of it
(Moran's I; Cliff & Ord, "Spatial Processes", 1981, chapter 8). Its excess gives the variance b^2
that neighbours share (method of moments), and errors with that covariance propagate to

    b^2 cov (sum over channels of J_c' K J_c) cov

Sees only what varies over the poses: an error common to all poses of a place, or one that
parameters can imitate, leaves no trace and is for other places to show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.nuisance import Observations, Settled
from solver.mechanism.model import Model

Array = NDArray[np.float64]

_LENGTH = 0.5  # of the kernel, in standard deviations of the readings over the poses
_MOST = 60  # poses looked at: the work grows with their cube
_FEWEST_FREEDOMS = 20.0
_SIGNIFICANT = 4.0  # standard deviations; the statistic is skewed to the right


@dataclass(frozen=True, slots=True)
class Correlation:
    """What the residuals of neighbouring poses share.

    Attributes:
        score: excess of the statistic in its standard deviations under noise alone.
        shared: variance that neighbours share, in units of the readings' own variance.
        widening: (n, n) covariance that errors so correlated add, SI; zero where not significant.
    """

    score: float
    shared: float
    widening: Array

    @property
    def significant(self) -> bool:
        """Whether noise alone would not do that."""
        return self.score > _SIGNIFICANT


def correlation(
    model: Model,
    observed: Observations,
    settled: Settled,
    parameters: Array,
    covariance: Array,
) -> Correlation | None:
    """What neighbouring poses share after a fit; None where too little is left over to tell.

    Args:
        model: the mechanism.
        observed: P poses.
        settled: they, at the solution.
        parameters: (N,) the solution.
        covariance: (n, n) of the identified parameters under noise, SI.
    """
    poses, channels, count = settled.jacobian.shape
    taken = np.arange(poses)
    if poses > _MOST:
        taken = np.linspace(0, poses - 1, _MOST).astype(np.intp)
    residual, jacobian = settled.residual[taken], settled.jacobian[taken]
    basis = _redundant(model, observed.take(taken), settled.coordinates[taken], parameters)
    across = np.swapaxes(basis, 1, 2)
    left = (across @ residual[:, :, None]).ravel()
    slopes = (across @ jacobian).reshape(len(left), count)
    kernel = _kernel(observed.counts[taken], observed.sigma[taken])
    tall = basis.transpose(0, 2, 1).reshape(len(left), channels)
    repeated = np.repeat(np.repeat(kernel, basis.shape[2], axis=0), basis.shape[2], axis=1)
    K = (tall @ tall.T) * repeated
    # Traces of products of K and R = I - S cov S', S tall and narrow, without forming R.
    KS = K @ slopes
    CA, CN = covariance @ (slopes.T @ KS), covariance @ (slopes.T @ slopes)
    freedoms = len(left) - float(np.trace(CN))
    if freedoms < _FEWEST_FREEDOMS:
        return None
    once = float(np.trace(K) - np.trace(CA))
    twice = float(np.sum(K**2) - 2 * np.sum(covariance * (KS.T @ KS)) + np.sum(CA * CA.T))
    mixed = float(np.trace(K) - 2 * np.trace(CA) + np.sum(CN * CA.T))
    square = len(left) - 2 * float(np.trace(CN)) + float(np.sum(CN * CN.T))
    c = once / freedoms
    variance = 2.0 * (twice - 2 * c * mixed + c**2 * square)
    excess = float(left @ K @ left - c * (left @ left))
    noise = float(left @ left) / freedoms
    score = excess / (noise * np.sqrt(variance)) if variance > 0 and noise > 0 else 0.0
    gain = twice - c * mixed
    shared = max(excess / gain, 0.0) if gain > 0 else 0.0
    widening = np.zeros((count, count))
    if score > _SIGNIFICANT:
        values, vectors = np.linalg.eigh(kernel)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        pull = covariance @ np.einsum("pcn,pm->ncm", jacobian, root).reshape(count, -1)
        widening = shared * (poses / len(taken)) ** 2 * (pull @ pull.T)
    return Correlation(score, shared, widening)


def _redundant(
    model: Model, observed: Observations, coordinates: Array, parameters: Array
) -> Array:
    """(P, C, r) orthonormal bases of what the readings of each pose have to spare."""
    nowhere = np.zeros((len(parameters), 0))
    at = model.linearise(coordinates, parameters, nowhere, observed.at)
    closures = at.closure_by_coordinates.shape[1]
    H = at.readings_by_coordinates / observed.sigma[:, :, None]
    if closures:
        norms = np.linalg.norm(H, axis=1)
        unit = 1.0 / np.where(norms > 0, norms, 1.0)
        open_ = np.linalg.svd(at.closure_by_coordinates * unit[:, None, :])[2][:, closures:]
        H = (H * unit[:, None, :]) @ np.swapaxes(open_, 1, 2)
    size = H.shape[2]
    return np.asarray(np.linalg.svd(H)[0][:, :, size:])


def _kernel(counts: Array, sigma: Array) -> Array:
    """(P, P) likeness of poses, 1 for the same readings."""
    spread = counts.std(axis=0)
    moved = spread > 3.0 * sigma.mean(axis=0)
    where = counts[:, moved] / spread[moved]
    size = max(where.shape[1], 1)
    square = np.sum(where**2, axis=1)
    apart = np.maximum(square[:, None] + square - 2.0 * where @ where.T, 0.0) / size
    return np.asarray(np.exp(-apart / (2.0 * _LENGTH**2)))
