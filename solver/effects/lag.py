"""``lag``: a channel is sampled, filtered or transmitted late: while it moves, it shows the past.

Only readings in motion show it (`solver.motion`). A delay that all channels share moves every
pose along its own path and shows in none of them: delays are known against each other.

The rate is taken from the channel itself, which is exact of a first-order filter (seen = v -
delay d seen/dt); a pure delay differs from that by delay^2 / 2 times the acceleration.
"""

from __future__ import annotations

from solver.effects.channel import ChannelEffect
from solver.effects.effect import Array, Coefficient, Shift, Site
from solver.mechanism.circumstances import Circumstances


class Lag(ChannelEffect):
    """delta = -delay dv/dt."""

    name = "lag"
    needs = ("rate",)

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.rate is None or not at.rate[:, site.channel(where)].any():
            return "recorded at standstill only: a lag shows in readings that are taken in motion"
        return None

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("delay", "time", 0.02, low=0.0),)

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        return None if at.rate is None else self.shift(-at.rate[:, [self.channel]], coefficients)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
