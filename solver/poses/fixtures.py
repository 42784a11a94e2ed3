"""The poses of a plan in every fixture of a rig: a session carries out its plan in each of them.

The stops of a plan are those that can be reached in all fixtures: from home in each, the drives
go straight to their targets, and every joint stays within its limits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig
from solver.errors import MechanismError
from solver.mechanism.model import Model
from solver.mechanism.serial import SerialModel
from solver.poses.reach import STEP, close_holding
from solver.poses.wander import assembled, limits, wander

Array = NDArray[np.float64]


def in_every_fixture(
    rig: Rig, model: Model, x: Array, drives: tuple[int, ...], coordinates: Array
) -> tuple[tuple[tuple[Model, Array], ...], NDArray[np.bool_]]:
    """The model in each fixture with the poses there, and which candidates all fixtures allow.

    Args:
        rig: the description.
        model: its mechanism; in its first fixture, where it has several.
        x: (N,) parameters, SI.
        drives: driven coordinates; none by hand.
        coordinates: (P, U) candidates in the first fixture.

    Returns:
        One pair a fixture, poses (Q, U) in the order of the candidates kept; which (P,) those are.

    Raises:
        MechanismError: the mechanism cannot be assembled in a fixture, or no candidate is
            within reach in all of them.
    """
    others = model.elsewhere if isinstance(model, SerialModel) else ()
    kept = np.ones(len(coordinates), dtype=bool)
    found: list[tuple[Model, Array]] = [(model, coordinates)]
    for number, other in enumerate(others, 1):
        if drives:
            there, reached = _driven(rig, other, x, drives, coordinates[:, drives])
            kept &= reached
        else:
            there = wander(rig, other, x, len(coordinates), seed=1 + number)
        found.append((other, there))
    if not kept.any():
        held = ", ".join(model.coordinate_names[drive] for drive in drives)
        raise MechanismError(
            f"driving {held}, rig '{rig.name}' has no stop that is within reach in all of its {1 + len(others)} "
            "fixtures; place them nearer to each other, or plan for each in a rig of its own"
        )
    return tuple((one, there[kept]) for one, there in found), kept


def _driven(
    rig: Rig, model: Model, x: Array, drives: tuple[int, ...], targets: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Closed configurations (P, U) with the drives at ``targets`` (P, k), and which were reached."""
    home = assembled(rig, model, x)
    low, high = limits(rig, model)
    way = targets - home[list(drives)]
    u = np.tile(home, (len(targets), 1))
    reached = np.ones(len(targets), dtype=bool)
    steps = max(1, int(np.ceil(np.abs(way).max(initial=0.0) / STEP)))
    for step in range(1, steps + 1):
        trial = u.copy()
        trial[:, drives] = home[list(drives)] + step / steps * way
        trial, closed = close_holding(model, trial, x, drives)
        reached &= closed & ((trial >= low) & (trial <= high)).all(axis=1)
        u[reached] = trial[reached]
    return u, reached
