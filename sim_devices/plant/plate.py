"""A plate on legs as it really is: leg lengths |base point - R plate point - t|, and what is read of them.

Owns geometry only: how the plate is moved is the hand's (`sim_devices.plant.hand`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from recordings.rig import PlatformMechanism
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.quaternion import Array, about, product, turn


@dataclass(frozen=True, slots=True)
class PlateGeometry:
    """Ends of L legs: arrays (L, 3), or (n, L, 3) where they vary by sample [m].

    Attributes:
        base: in the base frame.
        plate: in the plate frame.
    """

    base: Array
    plate: Array


def plate_geometry(mechanism: PlatformMechanism, values: Mapping[str, float]) -> PlateGeometry:
    """Geometry out of parameter values [m] by name."""

    def at(points: list[str]) -> Array:
        return np.array([[values[f"{point}.{axis}"] for axis in "xyz"] for point in points])

    return PlateGeometry(
        base=at([leg.base for leg in mechanism.legs]),
        plate=at([leg.plate for leg in mechanism.legs]),
    )


class Plate:
    """Leg lengths of a platform.

    Args:
        mechanism: the kind of plate, its legs and its neutral pose.
        geometry: as it really is, without effects.
        effects: all effects at work.
    """

    def __init__(
        self, mechanism: PlatformMechanism, geometry: PlateGeometry, effects: Sequence[Effect] = ()
    ) -> None:
        self._geometry = geometry
        self._effects = effects
        neutral = mechanism.neutral
        self.turns = mechanism.plate != "point"
        self.shifts = mechanism.plate != "pivoted"
        self.neutral_turn = product(
            about(np.array([0.0, 0.0, 1.0]), np.array(neutral.rz)),
            product(
                about(np.array([0.0, 1.0, 0.0]), np.array(neutral.ry)),
                about(np.array([1.0, 0.0, 0.0]), np.array(neutral.rx)),
            ),
        )
        self.neutral_shift = np.array([neutral.x, neutral.y, neutral.z]) * self.shifts
        if not self.turns:
            self.neutral_turn = np.array([1.0, 0.0, 0.0, 0.0])
        self._zero = np.zeros(len(mechanism.legs))
        if mechanism.leg_readings == "change":
            neutral_pose = self.neutral_turn[None], self.neutral_shift[None]
            self._zero = self.lengths(*neutral_pose, np.zeros(1))[0]

    def lengths(self, turned: Array, shifted: Array, time_s: Array) -> Array:
        """Leg lengths (n, L) [m] at plate turns (n, 4), shifts (n, 3) [m] and times (n,)."""
        geometry = self._geometry
        for effect in self._effects:
            geometry = effect.geometry(geometry, time_s, np.hstack([turned, shifted]))
        ends = turn(turned[:, None], geometry.plate) + shifted[:, None]
        return np.asarray(np.linalg.norm(geometry.base - ends, axis=-1))

    def readings(self, turned: Array, shifted: Array, time_s: Array) -> Array:
        """(n, L) what legs' channels sense [m]: lengths, or their change since the neutral pose."""
        return self.lengths(turned, shifted, time_s) - self._zero
