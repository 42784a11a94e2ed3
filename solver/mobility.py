"""Joints that cannot move while the endpoint is held: which they are, and what that costs.

The elbow of an anthropomorphic arm is the known case: with the hand held rigidly, shoulder and
wrist stay where they are, and so does the angle of the elbow between them. Its sensor then
reads one value for ever, and an offset of it looks like another length or another place of the hand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_RANK = 1e-6  # of the largest singular value
_MEMBER = 0.02  # of a held direction of unit length
_STILL = 1e-4  # of the motion of all joints together


def immobile(model: SerialModel, parameters: Array, coordinates: Array) -> NDArray[np.intp]:
    """Coordinates that the closed mechanism cannot move at any of ``coordinates`` (P, U).

    Args:
        model: the chain.
        parameters: (N,).
        coordinates: (P, U) closed configurations.
    """
    nowhere = np.zeros((len(parameters), 0))
    rates = model.linearise(coordinates, parameters, nowhere).closure_by_coordinates
    _, singular, right = np.linalg.svd(rates)
    rank = np.sum(singular > _RANK * singular[:, :1], axis=1)
    # Rows of V' behind the rank span the freedoms: motions that keep the loop closed.
    free = np.arange(right.shape[1])[None, :] >= rank[:, None]
    moves = np.sqrt(np.sum((right * free[:, :, None]) ** 2, axis=1))
    return np.flatnonzero(np.median(moves, axis=0) < _STILL)


def told(name: str, *, determined: bool) -> str:
    """What the immobility of the joint called ``name`` means for its user.

    ``determined``: whether the lengths and the fixture are known well enough to tell its offset.
    """
    if determined:
        lost = (
            "its offset rests on one angle and on the exact lengths and fixture that the rig states"
        )
    else:
        lost = "its offset is not identifiable"
    return (
        f"{name} cannot move while the endpoint is held like this: {lost}, and its gain shows nowhere. "
        "Free the endpoint (a hinge or a ball) to make it move, or hold them at known values."
    )


def offset_determined(space: ParameterSpace, held: Array, name: str, channel: str | None) -> bool:
    """Whether no direction of ``held`` (n, k), in plausible errors, moves the offset of joint ``name``."""
    names = (f"{name}.theta_offset", f"{name}.s", f"{channel}.offset")
    rows = [i for i, other in enumerate(space.names) if other in names]
    return bool(np.abs(held[rows]).max(initial=0.0) < _MEMBER)
