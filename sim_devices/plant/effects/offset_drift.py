"""``offset-drift``: the zero of a channel moves as the session goes on.

Hidden, it creeps evenly or saturates as electronics warm up (`warm_up.Creep`). Size: the slope of
its best straight line over the plan's stops [deg/s or m/s]. Described, it is rate times time, or fades
with a ``decay``. A drive does not follow the drift of its own sensor: it stands where it stood, and the readings move.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import (
    channel_dimension,
    channel_names,
    check_place,
    read_values,
)
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import number_size, per_second
from sim_devices.plant.effects.warm_up import Creep
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class OffsetDrift(Effect):
    """A creeping zero."""

    name = "offset-drift"

    def __init__(self, where: str, size: float, unit: str, rate: float, creep: Creep) -> None:
        super().__init__(where, size, unit)
        self._rate = rate
        self._creep = creep

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return channel_names(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where) == "angle"
        size = rng.uniform(0.2e-3, 3e-3) if angular else rng.uniform(0.2e-6, 3e-6)
        return f"{rng.choice([-1, 1]) * size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        unit, to_si = per_second(request.rig, request.where)
        rate = number_size(cls.name, request.size, unit, most=1.0, signed=True)
        creep = Creep.draw(request.rests(), request.rng)
        return cls(request.where, rate, unit, rate * to_si, creep)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        angular = channel_dimension(rig, effect.where) == "angle"
        speed = "angular speed" if angular else "speed"
        told = read_values(effect, values, {"rate": speed, "decay": "rate"})
        unit, to_si = per_second(rig, effect.where)
        creep = Creep.fading(told["decay"])
        return cls(effect.where, told["rate"] / to_si, unit, told["rate"], creep)

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + self._rate * self._creep.at(course.time_s))
