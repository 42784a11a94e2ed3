"""What a mechanism at rest carries, for either family; or why nobody can say.

Owns loads at given coordinates. What yields under them is the business of effects.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recordings.rig import PlatformMechanism, Rig
from solver.mechanism.chain_statics import compensated_loads, driven_loads
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.loads import Loads
from solver.mechanism.model import TILTS
from solver.mechanism.plate_statics import plate_loads

Array = NDArray[np.float64]


def why_unloaded(rig: Rig) -> str | None:
    """Why no loads can be computed from the description of ``rig``, in words; None where they can."""
    if rig.gravity is None:
        return "the rig does not say where gravity points: add gravity_m_per_s2"
    mechanism = rig.mechanism
    if isinstance(mechanism, PlatformMechanism):
        if mechanism.standing == "held-by-hand":
            return 'a hand carries the plate (standing = "held-by-hand"): nobody knows what the legs carry'
        if not mechanism.plate_mass:
            return "the rig gives no mass: add plate_mass_kg and plate_com_m"
    elif not any(joint.mass for joint in mechanism.joints):
        return "the rig gives no masses: add mass_kg and com_m to its joints"
    return None


def loads(
    rig: Rig,
    coordinates: Array,
    parameters: Array,
    held: NDArray[np.bool_] | None,
    at: Circumstances | None = None,
) -> Loads:
    """Loads of ``rig``'s mechanism, effects left out.

    Args:
        rig: with masses and gravity.
        coordinates: (P, U) closed poses, of the rig's model.
        parameters: (N,) of the rig without effects; what is behind them is not looked at.
        held: (P, J) whether a drive held each joint; None where nobody knows. Platforms need none.
        at: the fixtures that held the poses.
    """
    why = why_unloaded(rig)
    if why is not None:
        return Loads(None, None, why=why)
    if isinstance(rig.mechanism, PlatformMechanism):
        return plate_loads(rig, rig.mechanism, coordinates, parameters)
    if rig.mechanism.standing == "gravity-compensated":
        return compensated_loads(rig, rig.mechanism, coordinates, parameters)
    if held is None:
        return Loads(
            None,
            None,
            why="nobody recorded which joints a drive held: loads are computed for driven sessions, and where "
            'the mechanism has standing = "gravity-compensated"',
        )
    torque = np.zeros((len(coordinates), held.shape[1]))
    force = np.zeros((len(coordinates), 3))
    moment = np.zeros((*torque.shape, len(TILTS)))
    why = ""
    for pattern in np.unique(held, axis=0):
        rows = np.flatnonzero((held == pattern).all(axis=1))
        some = None if at is None else at.take(rows)
        found = driven_loads(rig, rig.mechanism, coordinates[rows], parameters, pattern, some)
        if found.torque is None:
            return found
        torque[rows] = found.torque
        if found.force is None or found.moment is None:
            why = found.why
        else:
            force[rows], moment[rows] = found.force, found.moment
    return Loads(torque, None, None, why) if why else Loads(torque, force, moment)
