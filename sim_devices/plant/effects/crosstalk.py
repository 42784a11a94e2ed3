"""``crosstalk``: one channel of a device leaks into another, before they are converted.

    counts_a - zero_a  +=  ratio (counts_b - zero_b)

with what b would count without noise, rounding or effects. Size: the ratio, or in percent. Hidden,
the leak is capacitive: it passes a little less of large signals, 1 % less at full scale of b.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import check_place, read_values
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import ratio_size
from sim_devices.plant.quaternion import Array

ARROW = "<-"
_SOFT = 0.01


class Crosstalk(Effect):
    """A leak into one channel out of another.

    Args:
        where: ``into<-from``.
        size: ratio of counts.
        full_steps: counts of the other channel at which a hidden leak is 1 % weaker, or infinite.
    """

    name = "crosstalk"

    def __init__(self, where: str, size: float, full_steps: float) -> None:
        super().__init__(where, size, "1")
        self._into, _, self._out_of = where.partition(ARROW)
        self._full_steps = full_steps

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return tuple(
            f"{into.name}{ARROW}{other.name}"
            for into in rig.channels
            for other in rig.channels
            if into is not other and into.device is not None and into.device == other.device
        )

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.choice([-1, 1]) * rng.uniform(0.2, 2.0):.3f}%"

    @classmethod
    def make(cls, request: Request) -> Self:
        ratio = ratio_size(cls.name, request.size, most=0.5)
        other = request.rig.channel(request.where.partition(ARROW)[2])
        low, high = other.count_range or (-np.inf, np.inf)
        return cls(request.where, ratio, (high - low) / 2)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        names = [channel.name for channel in rig.channels]
        pairs = [f"{a}{ARROW}{b}" for a in names for b in names if a != b]
        check_place(effect, pairs)
        return cls(effect.where, read_values(effect, values, {"ratio": "ratio"})["ratio"], np.inf)

    def steps(self, channel: str, steps: Array, steps_of: Callable[[str], Array]) -> Array:
        if channel != self._into:
            return steps
        other = steps_of(self._out_of)
        return np.asarray(steps + self.size * other * (1 - _SOFT * (other / self._full_steps) ** 2))
