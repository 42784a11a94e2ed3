"""``gain-error``: the scale of a channel is not the nominal one.

Size: a ratio (``0.01``) or ``1%``; the true gain is (1 + size) times what it would have been.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import parse_size
from sim_devices.plant.errors import BadEffect


class GainError(Effect):
    """A wrong scale."""

    name = "gain-error"

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return tuple(channel.name for channel in rig.channels)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.choice([-1, 1]) * rng.uniform(0.5, 2.0):.3f}%"

    @classmethod
    def make(cls, request: Request) -> Self:
        size = parse_size(cls.name, request.size)
        ratio = size.number / 100 if size.percent else size.number
        if not -0.5 <= ratio <= 0.5:
            raise BadEffect(
                f"the size of '{cls.name}' is '{request.size}', expected at most 0.5 (or 50%) either way"
            )
        return cls(request.where, ratio, "1")

    def values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        name = f"{self.where}.gain"
        return {**values, name: values[name] * (1 + self.size)}
