"""``backlash``: play between a joint and its sensor, so that a reading depends on the way it was reached.

The sensor's side is pushed by one flank of the gap or the other (the play operator of Prandtl,
after a motion longer than the gap): it trails half a gap behind.
"""

from __future__ import annotations

import numpy as np

from solver.effects.channel import ChannelEffect
from solver.effects.effect import Array, Coefficient, Shift, Site
from solver.mechanism.circumstances import Circumstances


class Backlash(ChannelEffect):
    """delta = -gap/2 after moving to larger values, +gap/2 after moving to smaller ones."""

    name = "backlash"
    needs = ("approach",)

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.approach is None:
            return "nobody knows from which side the channel came to rest: record the way between the dwells"
        if not np.ptp(at.approach[:, site.channel(where)]):
            return "the channel came to rest from one side only: approach some poses from both"
        return None

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("gap", self.measures, self.of_size(2e-3, 1e-4), low=0.0),)

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        if at.approach is None:
            return None
        return self.shift(-0.5 * at.approach[:, [self.channel]], coefficients)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
