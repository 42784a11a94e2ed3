"""``gain-error``: the scale of a channel is not the nominal one.

Size: a ratio (``0.01``) or ``1%``; the true gain is (1 + size) times what it would have been.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import channel_names, check_place, read_values
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import ratio_size


class GainError(Effect):
    """A wrong scale."""

    name = "gain-error"

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return channel_names(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.choice([-1, 1]) * rng.uniform(0.5, 2.0):.3f}%"

    @classmethod
    def make(cls, request: Request) -> Self:
        return cls(request.where, ratio_size(cls.name, request.size, most=0.5), "1")

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        return cls(effect.where, read_values(effect, values, {"ratio": "ratio"})["ratio"], "1")

    def values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        name = f"{self.where}.gain"
        return {**values, name: values[name] * (1 + self.size)}
