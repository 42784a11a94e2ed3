"""``lag``: a channel is sampled late, or filtered: what it shows is behind what is there.

Hidden, the channel has a first-order filter of time constant T, exact for values that go straight
from sample to sample: with z = seen - v and the speed u of a sample interval d,

    z(t + d) = z(t) exp(-d/T) - T u (1 - exp(-d/T)).

At constant speed it trails by T u, and at rest it catches up. Size: T [s]. Described, the channel
shows v - delay dv/dt.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import channel_names, check_place, read_values
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class Lag(Effect):
    """A channel behind its time.

    Args:
        where: channel.
        size: delay or time constant [s].
        filtered: whether it is a filter; else the described form.
    """

    name = "lag"

    def __init__(self, where: str, size: float, filtered: bool) -> None:
        super().__init__(where, size, "s")
        self._filtered = filtered
        self._last_s = np.inf
        self._value = 0.0
        self._behind = 0.0

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return channel_names(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.005, 0.04):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        return cls(request.where, number_size(cls.name, request.size, "s", most=5.0), True)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        return cls(effect.where, read_values(effect, values, {"delay": "time"})["delay"], False)

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self.where:
            return value
        if not self._filtered:
            return np.asarray(value - self.size * course.rate[channel])
        if course.time_s[0] < self._last_s:
            # Another run begins, at rest.
            self._last_s, self._value, self._behind = float(course.time_s[0]), float(value[0]), 0.0
        step_s = np.diff(course.time_s, prepend=self._last_s)
        moved = np.diff(value, prepend=self._value)
        kept = np.exp(-step_s / self.size)
        speed = np.divide(moved, step_s, out=np.zeros_like(moved), where=step_s > 0)
        behind, out = self._behind, []
        for k, new in zip(kept.tolist(), (self.size * speed * (1 - kept)).tolist(), strict=True):
            behind = behind * k - new
            out.append(behind)
        self._last_s, self._value = float(course.time_s[-1]), float(value[-1])
        self._behind = behind
        return np.asarray(value + np.array(out))
