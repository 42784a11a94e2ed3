"""Rotation matrices and rotation vectors, for stacks of poses.

Owns the exponential and logarithm of SO(3) and the Jacobian of the logarithm. Formulas:
Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", appendix B.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SMALL = 1e-4  # below this angle [rad] the series are exact to 1e-16


def skew(vector: Array) -> Array:
    """Cross-product matrices, (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*vector.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -vector[..., 2], vector[..., 1]
    out[..., 1, 0], out[..., 1, 2] = vector[..., 2], -vector[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return out


def exponential(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < _SMALL, 1.0, angle)
    first = np.where(angle < _SMALL, 1 - angle**2 / 6, np.sin(safe) / safe)
    second = np.where(angle < _SMALL, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    hat = skew(vector)
    out: Array = np.eye(3) + first * hat + second * (hat @ hat)
    return out


def logarithm(rotation: Array) -> Array:
    """Rotation vectors (..., 3) [rad], of length at most pi, of matrices (..., 3, 3)."""
    twice = np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.linalg.norm(twice, axis=-1)
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1)
    angle = np.arctan2(sine, cosine)
    near_half_turn = (cosine < -0.99)[..., None]
    factor = np.where(
        sine < _SMALL, 0.5 + angle**2 / 12, 0.5 * angle / np.where(sine < _SMALL, 1.0, sine)
    )
    vector: Array = factor[..., None] * twice
    if not near_half_turn.any():
        return vector
    # Near a half turn the antisymmetric part vanishes: the axis comes from the symmetric part.
    symmetric = 0.5 * (rotation + np.swapaxes(rotation, -1, -2)) - cosine[..., None, None] * np.eye(
        3
    )
    column = np.argmax(np.diagonal(symmetric, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(symmetric, column[..., None, None], axis=-1)[..., 0]
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    sign = np.where(np.sum(axis * twice, axis=-1, keepdims=True) < 0, -1.0, 1.0)
    corrected: Array = np.where(near_half_turn, sign * axis * angle[..., None], vector)
    return corrected


def log_rate(vector: Array) -> Array:
    """Inverse left Jacobian (..., 3, 3): rate of the rotation vector per angular velocity of the start frame."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < _SMALL, 1.0, angle)
    half = 0.5 * safe
    second = np.where(angle < _SMALL, 1 / 12 + angle**2 / 720, (1 - half / np.tan(half)) / safe**2)
    hat = skew(vector)
    out: Array = np.eye(3) - 0.5 * hat + second * (hat @ hat)
    return out


def left_jacobian(vector: Array) -> Array:
    """Left Jacobian (..., 3, 3): angular velocity of the start frame per rate of the rotation vector."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < _SMALL, 1.0, angle)
    first = np.where(angle < _SMALL, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(angle < _SMALL, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    hat = skew(vector)
    out: Array = np.eye(3) + first * hat + second * (hat @ hat)
    return out
