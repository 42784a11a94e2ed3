"""``outsider:product-error``: a neighbour's magnet changes a channel's scale as it moves.

    seen_a = v_a + k (v_a - a_0) (v_b - b_0),   a_0, b_0 the middles of the plan's travel

Neither channel alone shows it. Size: RMS about the mean over the plan's stops [deg or m]; it takes
two channels of one device.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.crosstalk import ARROW, Crosstalk
from sim_devices.plant.effects.described import channel_dimension
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.rms import rms_about_mean
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class ProductError(Effect):
    """A channel whose scale depends on another.

    Args:
        where: ``into<-from``.
        size: RMS about the mean over the plan's stops [``unit``].
        unit: "deg" or "m".
        factor: k [1/rad or 1/m, of the other channel].
        middles: a_0 and b_0.
    """

    name = "outsider:product-error"

    def __init__(
        self, where: str, size: float, unit: str, factor: float, middles: tuple[float, float]
    ) -> None:
        super().__init__(where, size, unit)
        self._into, _, self._by = where.partition(ARROW)
        self._factor, self._middles = factor, middles

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return Crosstalk.places(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where.partition(ARROW)[0]) == "angle"
        return f"{rng.uniform(0.05, 0.5) if angular else rng.uniform(0.05e-3, 0.3e-3):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        into, _, by = request.where.partition(ARROW)
        unit, to_si = channel_unit(request.rig, into)
        size = number_size(cls.name, request.size, unit, most=20.0)
        a, b = request.rests().value[into], request.rests().value[by]
        middles = (float(a.min() + a.max()) / 2, float(b.min() + b.max()) / 2)
        rms = rms_about_mean((a - middles[0]) * (b - middles[1]))
        factor = size * to_si / rms if rms > 0 else np.inf
        if factor * np.ptp(b) > 0.5:
            raise BadEffect(
                f"the size of '{cls.name}@{request.where}' is '{request.size}' {unit}, which over the travel of "
                "this plan changes the scale by more than a quarter; ask for less"
            )
        return cls(request.where, size, unit, factor, middles)

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self._into:
            return value
        a_0, b_0 = self._middles
        return np.asarray(value + self._factor * (value - a_0) * (course.value[self._by] - b_0))
