"""``saturation``: the converter ends inside the travel that the plan uses; counts stop at its rail.

Size: how far the travel at the plan's stops goes beyond the rail [deg or m]; which of the two
rails is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numpy.typing import NDArray

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import channel_names, check_place, read_values
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.effects.stuck_bit import converters
from sim_devices.plant.errors import BadEffect

_MOST = 0.4
"""Largest share of the travel beyond the rail."""


class Saturation(Effect):
    """Counts that end at ``low`` and ``high``."""

    name = "saturation"

    def __init__(self, where: str, size: float, unit: str, low: float, high: float) -> None:
        super().__init__(where, size, unit)
        self._low, self._high = low, high

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return converters(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        low, high = rig.channel(where).count_range or (0, 1)
        full = abs(rig.channel(where).gain.nominal) * (high - low) / channel_unit(rig, where)[1]
        return f"{full * rng.uniform(0.005, 0.03):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        channel = request.rig.channel(request.where)
        unit, to_si = channel_unit(request.rig, request.where)
        size = number_size(cls.name, request.size, unit, most=1e3)
        gain, offset = (request.values[f"{channel.name}.{part}"] for part in ("gain", "offset"))
        used = channel.zero_count + (request.rests().value[channel.name] - offset) / gain
        low, high = float(used.min()), float(used.max())
        beyond = size * to_si / abs(gain)
        if beyond > _MOST * (high - low):
            raise BadEffect(
                f"the size of '{cls.name}@{request.where}' is '{request.size}' {unit}, expected at most "
                f"{_MOST * (high - low) * abs(gain) / to_si:.4g} {unit}, {100 * _MOST:g}% of the travel of the plan"
            )
        if request.rng.integers(2):
            return cls(request.where, size, unit, -np.inf, round(high - beyond))
        return cls(request.where, size, unit, round(low + beyond), np.inf)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, channel_names(rig))
        true = read_values(effect, values, {"low": "count", "high": "count"})
        low = true["low"] if "low" in effect.values else -np.inf
        high = true["high"] if "high" in effect.values else np.inf
        if not low < high:
            raise BadEffect(f"the effect '{effect.label}' has 'high_counts' not above 'low_counts'")
        unit, _ = channel_unit(rig, effect.where)
        return cls(effect.where, 0.0, unit, low, high)

    def counts(self, channel: str, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        if channel != self.where:
            return counts
        return np.asarray(np.clip(counts.astype(float), self._low, self._high).astype(np.int64))
