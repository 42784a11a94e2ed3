"""Unit quaternions, scalar first, in arrays of any leading shape.

A quaternion q turns a vector v into q v q*. Owns the algebra that nature's mechanisms share.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0])
IDENTITY.flags.writeable = False


def product(p: Array, q: Array) -> Array:
    """Hamilton product p q, shapes (..., 4): first q turns, then p."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def _axes_of_squares() -> Array:
    """(16, 9): row 4 i + k says how the product q_i q_k enters each coordinate of each axis."""
    out = np.zeros((4, 4, 3, 3))
    w, x, y, z = range(4)
    for axis, (i, j, k) in enumerate(((x, y, z), (y, z, x), (z, x, y))):
        a, b, c = axis, (axis + 1) % 3, (axis + 2) % 3
        for square, sign in ((w, 1.0), (i, 1.0), (j, -1.0), (k, -1.0)):
            out[square, square, axis, a] = sign
        for one, other, coordinate, sign in (
            (i, j, b, 1.0),
            (w, k, b, 1.0),
            (i, k, c, 1.0),
            (w, j, c, -1.0),
        ):
            out[one, other, axis, coordinate] += sign
            out[other, one, axis, coordinate] += sign
    return out.reshape(16, 9)


def _cross_of_pairs() -> Array:
    """(9, 3): row 3 i + k says how u_i v_k enters each coordinate of u x v."""
    out = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[i, j, k], out[j, i, k] = 1.0, -1.0
    return out.reshape(9, 3)


_AXES = _axes_of_squares()
_CROSS = _cross_of_pairs()
_COLUMN = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGN = np.array([[1.0, -1, -1, -1], [1, 1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1]])


def running_product(start: Array, factors: Array) -> Array:
    """Start, start f0, start f0 f1, ...: shapes (n, 4), (n, J, 4) -> (n, J + 1, 4)."""
    out = np.empty((factors.shape[0], factors.shape[1] + 1, 4))
    out[:, 0] = start
    by_factor = factors[..., _COLUMN] * _SIGN  # q f as a matrix times q
    for j in range(factors.shape[1]):
        np.einsum("nij,nj->ni", by_factor[:, j], out[:, j], out=out[:, j + 1])
    return out


def axes(q: Array) -> Array:
    """The turned x, y and z axes, one a row: (..., 4) -> (..., 3, 3)."""
    squares = (q[..., :, None] * q[..., None, :]).reshape(*q.shape[:-1], 16)
    return np.asarray((squares @ _AXES).reshape(*q.shape[:-1], 3, 3))


def turn(q: Array, v: Array) -> Array:
    """Vectors ``v`` (..., 3) turned by ``q`` (..., 4), leading shapes broadcast."""
    return np.asarray((v[..., None, :] @ axes(q))[..., 0, :])


def cross(u: Array, v: Array) -> Array:
    """u x v over the last axis, leading shapes broadcast; numpy's own is slow for few vectors."""
    pairs = u[..., :, None] * v[..., None, :]
    return np.asarray(pairs.reshape(*pairs.shape[:-2], 9) @ _CROSS)


def about(axis: Array, angle_rad: Array) -> Array:
    """Turn by ``angle_rad`` (...) about the unit vectors ``axis`` (..., 3)."""
    half = np.asarray(angle_rad)[..., None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)


def angle_between(p: Array, q: Array) -> Array:
    """Smallest angle [rad] that turns p into q, shapes (..., 4) -> (...)."""
    return np.asarray(2 * np.arccos(np.clip(np.abs(np.sum(p * q, axis=-1)), 0.0, 1.0)))


def between(p: Array, q: Array, s: Array) -> Array:
    """Great arc from p (4,) to q (4,) by the shorter way, at fractions ``s`` (n,) -> (n, 4)."""
    if p @ q < 0:
        q = -q
    angle = np.arccos(np.clip(p @ q, -1.0, 1.0))
    if angle < 1e-9:
        return np.broadcast_to(p, (len(s), 4)).copy()
    weight_p, weight_q = np.sin((1 - s) * angle), np.sin(s * angle)
    return (weight_p[:, None] * p + weight_q[:, None] * q) / np.sin(angle)
