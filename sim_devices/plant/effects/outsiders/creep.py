"""``outsider:creep``: a coupling of rubber or plastic gives the last bit of a move back slowly.

What is seen is behind by a share of what a first-order filter of some ten seconds is behind: right
after a move the share of the whole move, and at rest less and less, with the history of all
moves before. Size: the share, as a ratio or in percent.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.lag import Lag
from sim_devices.plant.effects.size import ratio_size
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array


class Creep(Effect):
    """A channel that arrives slowly.

    Args:
        where: channel.
        size: share of a move.
        relaxation_s: time constant.
    """

    name = "outsider:creep"

    def __init__(self, where: str, size: float, relaxation_s: float) -> None:
        super().__init__(where, size, "1")
        self._filter = Lag(where, relaxation_s, filtered=True)

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return tuple(c.name for c in rig.channels if c.senses in rig.mechanism.places)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.2, 1.0):.3f}%"

    @classmethod
    def make(cls, request: Request) -> Self:
        share = ratio_size(cls.name, request.size, most=0.5)
        return cls(request.where, share, float(request.rng.uniform(5.0, 15.0)))

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + self.size * (self._filter.seen(channel, value, course) - value))
