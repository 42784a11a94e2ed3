"""``offset-drift``: the zero of a channel moves evenly as the session goes on, as warming electronics do."""

from __future__ import annotations

import numpy as np

from solver.effects.channel import ChannelEffect
from solver.effects.effect import Array, Coefficient, Shift, Site
from solver.mechanism.circumstances import Circumstances


class OffsetDrift(ChannelEffect):
    """delta = rate t, t since the session began."""

    name = "offset-drift"
    needs = ("time_s",)

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.time_s is None:
            return "nobody knows when the poses were read"
        if not np.ptp(at.time_s):
            return "all poses were read at one time"
        return None

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        speed = "angular speed" if self.measures == "angle" else "speed"
        return (Coefficient("rate", speed, self.of_size(1e-5, 1e-6)),)

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        since = at.running_s
        return None if since is None else self.shift(since[:, None], coefficients)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
