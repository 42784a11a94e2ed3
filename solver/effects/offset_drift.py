"""``offset-drift``: the zero of a channel moves as the session goes on, as that of warming electronics does."""

from __future__ import annotations

import numpy as np

from solver.effects.channel import ChannelEffect
from solver.effects.effect import Array, Coefficient, Shift
from solver.effects.warm_up import WarmUp
from solver.mechanism.circumstances import Circumstances


class OffsetDrift(WarmUp, ChannelEffect):
    """delta = rate c(t), with c of `warm_up`."""

    name = "offset-drift"

    @property
    def rate(self) -> Coefficient:
        speed = "angular speed" if self.measures == "angle" else "speed"
        return Coefficient("rate", speed, self.of_size(1e-5, 1e-6))

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        moved = self.moved_by(coefficients, at)
        if moved is None:
            return None
        amount, by = moved
        target = np.array([self.channel], dtype=np.intp)
        return Shift(target, amount[:, None], by[:, None, :])
