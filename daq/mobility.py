"""How many joints of a closed loop may be held at once, and which: its mobility.

A loop of mobility m is fully held by m joints. One more, or m that cannot move independently
of each other, and the drives press against each other through the mechanism with all their
torque. Exact motions come from outside, from whoever knows kinematics (`loopcal`); where
nobody says, the freedoms are counted as Kutzbach does, which are never too many.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import PlatformMechanism, Rig, SerialMechanism

_DEPENDENT = 1e-6
"""Smallest singular value of the motions of joints that move independently, of unit motions."""

_PLATE_FREEDOMS = {"pivoted": 3, "free": 6, "point": 3}
_ENDPOINT_FREEDOMS = 6


@dataclass(frozen=True)
class Mobility:
    """In which ways a closed mechanism can move.

    Attributes:
        freedoms: number of independent motions m.
        places: joints or legs that ``motions`` speak of; () where it is None.
        motions: (P, places, m) orthonormal motions [rad or m] at P configurations, or None
            where only their number is known.
    """

    freedoms: int
    places: tuple[str, ...] = ()
    motions: NDArray[np.float64] | None = None

    def fights(self, joints: Collection[str]) -> str:
        """Why ``joints`` must not be held in position together; "" where they may."""
        names = ", ".join(sorted(joints))
        if len(joints) > self.freedoms:
            return (
                f"{len(joints)} joints in position mode ({names}) over-constrain a mechanism of "
                f"mobility {self.freedoms}"
            )
        rows = [self.places.index(joint) for joint in joints if joint in self.places]
        if self.motions is None or len(rows) < 2:
            return ""
        smallest = np.linalg.svd(self.motions[:, rows], compute_uv=False)[:, -1]
        if float(smallest.max()) < _DEPENDENT:
            return (
                f"{names} cannot move independently of each other, so holding them all in "
                "position over-constrains the mechanism"
            )
        return ""


def counted(rig: Rig) -> Mobility:
    """Freedoms of the mechanism by count of joints and constraints (Kutzbach): the least it can have."""
    mechanism = rig.mechanism
    if isinstance(mechanism, PlatformMechanism):
        return Mobility(_PLATE_FREEDOMS[mechanism.plate])
    assert isinstance(mechanism, SerialMechanism)
    held = _ENDPOINT_FREEDOMS - len(mechanism.closure.freedoms)
    return Mobility(max(0, len(mechanism.joints) - held))
