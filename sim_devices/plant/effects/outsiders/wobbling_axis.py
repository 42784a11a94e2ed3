"""``outsider:wobbling-axis``: a worn bearing lets a joint's axis run about as it turns.

The link behind it tilts by w cos(2 theta + p) about its own x axis, as on two unequal races, and is
shifted by w l sin(2 theta + p) along it and w l cos(theta + q) along the joint's, l = 50 mm. Size: w [deg].
"""

from __future__ import annotations

from dataclasses import replace
from typing import Self, cast

import numpy as np

from recordings.rig import Rig, SerialMechanism
from sim_devices.plant.chain import ChainGeometry
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.quaternion import Array

_BEARING_M = 0.05


class WobblingAxis(Effect):
    """A joint that wobbles.

    Args:
        where: joint.
        size: greatest tilt [deg].
        joint: its number.
        phase: p and q [rad].
    """

    name = "outsider:wobbling-axis"
    steady = True

    def __init__(self, where: str, size: float, joint: int, phase: tuple[float, float]) -> None:
        super().__init__(where, size, "deg")
        self._tilt, self._joint, self._phase = np.deg2rad(size), joint, phase

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        if not isinstance(rig.mechanism, SerialMechanism):
            return ()
        return tuple(joint.name for joint in rig.mechanism.joints if joint.type == "revolute")

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.05, 0.5):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        size = number_size(cls.name, request.size, "deg", most=5.0)
        first, second = request.rng.uniform(0.0, 2 * np.pi, 2).tolist()
        joint = request.rig.mechanism.places.index(request.where)
        return cls(request.where, size, joint, (first, second))

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        if not isinstance(geometry, ChainGeometry):
            return geometry
        theta = coordinates[:, self._joint]
        tilt, along, lift = np.zeros((3, *coordinates.shape))
        tilt[:, self._joint] = self._tilt * np.cos(2 * theta + self._phase[0])
        along[:, self._joint] = self._tilt * _BEARING_M * np.sin(2 * theta + self._phase[0])
        lift[:, self._joint] = self._tilt * _BEARING_M * np.cos(theta + self._phase[1])
        wobbling = replace(
            geometry, alpha=geometry.alpha + tilt, a=geometry.a + along, s=geometry.s + lift
        )
        return cast(Geometry, wobbling)
