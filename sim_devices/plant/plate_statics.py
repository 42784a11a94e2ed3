"""What gravity asks of the legs of a plate that stands on them, and of its pivot.

Free-body: leg k pulls the plate with its tension t_k along u_k, from its plate end to its base
end; forces and moments on the plate vanish, as far as its freedoms go:

    point     sum t u + m g = 0
    free      and sum t (b x u) + c x m g = 0, about the plate's origin
    pivoted   the moments only, about the pivot; the pivot bears the forces

Where there are more legs than freedoms, equal legs share: of all solutions the one of least
elastic energy, which is the one of least norm.

Owns loads only: what gives way under them are effects (`sim_devices.plant.effects`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recordings.rig import PlatformMechanism, Rig
from sim_devices.plant.plate import PlateGeometry
from sim_devices.plant.quaternion import Array, cross, turn

_REGULAR = 1e-13


@dataclass(frozen=True, slots=True)
class PlateLoads:
    """Loads of n poses.

    Attributes:
        tension: (n, L) of the legs [N], below 0 where they push.
        along: (n, L, 3) unit vectors from plate ends to base ends, in the base frame.
        force: (n, 3) that the plate exerts on its pivot [N], in the base frame; else 0.
    """

    tension: Array
    along: Array
    force: Array


def has_weight(rig: Rig) -> bool:
    """Whether a platform has what loads are computed from, and stands on its legs."""
    mechanism = rig.mechanism
    return (
        isinstance(mechanism, PlatformMechanism)
        and rig.gravity is not None
        and bool(mechanism.plate_mass)
        and mechanism.standing == "on-legs"
    )


class PlateStatics:
    """Loads of a platform.

    Args:
        mechanism: with the mass of its plate.
        gravity: (3,) in the base frame [m/s^2].
    """

    def __init__(self, mechanism: PlatformMechanism, gravity: Array) -> None:
        self._kind = mechanism.plate
        self._weight = (mechanism.plate_mass or 0.0) * gravity
        self._com = np.array(mechanism.plate_com or (0.0, 0.0, 0.0))

    def loads(self, geometry: PlateGeometry, turned: Array, shifted: Array) -> PlateLoads:
        """Loads at plate turns (n, 4) and shifts (n, 3) [m]."""
        arm = turn(turned[:, None], geometry.plate)
        way = geometry.base - arm - shifted[:, None]
        along = way / np.linalg.norm(way, axis=-1, keepdims=True)
        swing = cross(arm, along)
        tip = cross(turn(turned, self._com), self._weight)
        weight = np.broadcast_to(self._weight, tip.shape)
        rows, load = {
            "point": (along, weight),
            "pivoted": (swing, tip),
            "free": (np.concatenate([along, swing], axis=2), np.concatenate([weight, tip], axis=1)),
        }[self._kind]
        normal = rows.transpose(0, 2, 1) @ rows
        trace = np.trace(normal, axis1=1, axis2=2)
        normal += (_REGULAR * trace + 1e-300)[:, None, None] * np.eye(normal.shape[1])
        tension = -(rows @ np.linalg.solve(normal, load[:, :, None]))[:, :, 0]
        pulled = (along * tension[:, :, None]).sum(axis=1)
        force = weight + pulled if self._kind == "pivoted" else np.zeros_like(tip)
        return PlateLoads(tension, along, force)
