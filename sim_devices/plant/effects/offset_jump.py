"""``offset-jump``: the zero of a channel moves at one moment: lost counts, a slipped coupling.

Hidden, it happens somewhere in the middle half of the session. Size: the step [deg or m]. Hidden
and described are alike: nothing before, the whole step from then on.
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
from sim_devices.plant.effects.effect import Effect, Request, moment_within
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class OffsetJump(Effect):
    """A zero that jumps at ``at_s`` by ``step`` [rad or m]."""

    name = "offset-jump"

    def __init__(self, where: str, size: float, unit: str, step: float, at_s: float) -> None:
        super().__init__(where, size, unit)
        self._step = step
        self._at_s = at_s

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return channel_names(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where) == "angle"
        size = rng.uniform(0.02, 0.3) if angular else rng.uniform(0.02e-3, 0.3e-3)
        return f"{rng.choice([-1, 1]) * size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        unit, to_si = channel_unit(request.rig, request.where)
        step = number_size(cls.name, request.size, unit, most=90.0, signed=True)
        return cls(request.where, step, unit, step * to_si, moment_within(request))

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        dimension = channel_dimension(rig, effect.where)
        true = read_values(effect, values, {"step": dimension}, {"at": "time"})
        unit, to_si = channel_unit(rig, effect.where)
        return cls(effect.where, true["step"] / to_si, unit, true["step"], true["at"])

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + np.where(course.time_s >= self._at_s, self._step, 0.0))
