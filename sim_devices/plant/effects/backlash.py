"""``backlash``: what is seen trails behind the motion by half a gap.

The play operator (Prandtl): the sensor's side moves only while a flank of the gap pushes it,

    seen_k = min(max(seen_k-1, v_k - gap/2), v_k + gap/2)

so that what is seen at rest depends on the direction of approach, and reversals within the gap
do not show at all. It begins in the middle of the gap. Size: the gap [deg or m]. Hidden and
described are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import channel_dimension, check_place, read_values
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class Backlash(Effect):
    """Play between a joint or leg and its sensor."""

    name = "backlash"

    def __init__(self, where: str, size: float, unit: str, gap: float) -> None:
        super().__init__(where, size, unit)
        self._half = gap / 2
        self._last_s = np.inf
        self._trails = 0.0

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return tuple(c.name for c in rig.channels if c.senses in rig.mechanism.places)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where) == "angle"
        size = rng.uniform(0.02, 0.3) if angular else rng.uniform(0.02e-3, 0.2e-3)
        return f"{size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        unit, to_si = channel_unit(request.rig, request.where)
        gap = number_size(cls.name, request.size, unit, most=10.0)
        return cls(request.where, gap, unit, gap * to_si)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        dimension = channel_dimension(rig, effect.where)
        gap = read_values(effect, values, {"gap": dimension})["gap"]
        if gap < 0:
            raise BadEffect(
                f"the effect '{effect.label}' has the gap {gap:.3g}, expected 0 or above"
            )
        unit, to_si = channel_unit(rig, effect.where)
        return cls(effect.where, gap / to_si, unit, gap)

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self.where:
            return value
        if course.time_s[0] < self._last_s:
            # Another run begins.
            self._trails = float(value[0])
        half, trails = self._half, self._trails
        out = []
        for v in value.tolist():
            trails = min(max(trails, v - half), v + half)
            out.append(trails)
        self._trails, self._last_s = trails, float(course.time_s[-1])
        return np.array(out)
