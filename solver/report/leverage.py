"""How large the residual of each reading may be expected to be from sensor noise alone.

A reading that the loop checks only weakly is followed by the fit, and its residual is smaller
than its noise. With H = W dh/du along the motions that keep the loop closed, the residuals of
a pose have the covariance I - H (H'H)^-1 H'; the parameters' own share is left out, which is
n / P of an equation a pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.mechanism.model import Model
from solver.samples import PoseTable

Array = NDArray[np.float64]


def expected_residuals(
    model: Model, table: PoseTable, coordinates: Array, parameters: Array
) -> Array:
    """(P, C) standard deviations of the whitened residuals that noise alone would leave.

    Args:
        model: the mechanism.
        table: the P averaged poses, for their standard deviations.
        coordinates: (P, U), the poses as settled.
        parameters: (N,).
    """
    at = model.linearise(coordinates, parameters, np.zeros((len(parameters), 0)))
    weighted = at.readings_by_coordinates / table.sigma[:, :, None]
    norms = np.linalg.norm(weighted, axis=1)
    scale = 1.0 / np.where(norms > 0, norms, np.where(norms > 0, norms, np.inf).min())
    free = model.mobility(coordinates, parameters)
    if at.closure.shape[1]:
        closing = at.closure_by_coordinates * scale[:, None, :]
        closing /= np.maximum(np.linalg.norm(closing, axis=2, keepdims=True), 1e-300)
        _, _, right = np.linalg.svd(closing)
        motions = np.swapaxes(right[:, right.shape[1] - free :], 1, 2)
    else:
        motions = np.tile(np.eye(free), (len(coordinates), 1, 1))
    along, _ = np.linalg.qr((weighted * scale[:, None, :]) @ motions)
    left: Array = np.sqrt(np.maximum(1.0 - np.sum(along**2, axis=2), 0.0))
    return left
