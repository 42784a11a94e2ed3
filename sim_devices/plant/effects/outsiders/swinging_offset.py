"""``outsider:swinging-offset``: a zero follows the room, which a thermostat heats and lets cool.

A saw of warming and cooling, smoothed by the sensor's mass: the first and third harmonics of a
period of which a few fit into the session. Size: RMS about the mean over the plan's stops [deg or m].
"""

from __future__ import annotations

from typing import Self

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.described import channel_dimension, channel_names
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.rms import rms_about_mean
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class SwingingOffset(Effect):
    """A zero that swings.

    Args:
        where: channel.
        size: RMS about the mean over the plan's stops [``unit``].
        unit: "deg" or "m".
        swing: (2,) amplitudes of the first and third harmonic [rad or m].
        period_s: of the first.
        phase: (2,) [rad].
    """

    name = "outsider:swinging-offset"

    def __init__(
        self, where: str, size: float, unit: str, *, swing: Array, period_s: float, phase: Array
    ) -> None:
        super().__init__(where, size, unit)
        self._swing, self._period_s, self._phase = swing, period_s, phase

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return channel_names(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where) == "angle"
        return f"{rng.uniform(0.02, 0.2) if angular else rng.uniform(0.02e-3, 0.2e-3):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        unit, to_si = channel_unit(request.rig, request.where)
        size = number_size(cls.name, request.size, unit, most=20.0)
        rests = request.rests()
        period_s = rests.end_s * float(request.rng.uniform(0.15, 0.4))
        phase = request.rng.uniform(0.0, 2 * np.pi, 2)
        swing = np.array([1.0, 0.15])
        factor = size * to_si / rms_about_mean(_swung(rests.time_s, swing, period_s, phase))
        return cls(request.where, size, unit, swing=factor * swing, period_s=period_s, phase=phase)

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + _swung(course.time_s, self._swing, self._period_s, self._phase))


def _swung(time_s: Array, swing: Array, period_s: float, phase: Array) -> Array:
    turns = 2 * np.pi * time_s[:, None] / period_s * np.array([1.0, 3.0]) + phase
    return np.asarray(np.cos(turns) @ swing)
