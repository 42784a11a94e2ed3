"""``saturation``: a converter ends inside the travel of its channel; counts stop at its rail.

The mean of a clipped Gaussian reading y of standard deviation s: with g(z) = z Phi(z) + phi(z),

    E[min(max(y, low), high)] = low + s (g((y - low) / s) - g((y - high) / s)).
"""

from __future__ import annotations

from typing import Self

import numpy as np

from recordings.rig import DescribedEffect
from solver.effects.channel import ChannelEffect
from solver.effects.converter import below, density, spread
from solver.effects.effect import Array, Coded, Coefficient, Recorded, Site
from solver.effects.stuck_bit import converters
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances

_SIDES = ("low", "high")
_AT_RAIL = 3  # poses that a rail holds at the least, within the noise of one sample


class Saturation(ChannelEffect):
    """Counts end at ``low`` or ``high``, or at both; the side that is not given does not end.

    Args:
        site: the rig.
        where: the channel.
        ends: by side, the counts at which a fit begins.
    """

    name = "saturation"
    needs = ("noise",)

    def __init__(self, site: Site, where: str, ends: dict[str, float]) -> None:
        super().__init__(site, where)
        self._ends = ends

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return converters(site)

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        """The sides at which counts pile up; none where they pile up at neither."""
        if recorded.counts is None:
            return ()
        counts = recorded.counts[:, site.channel(where)]
        near = max(1.0, float(spread(recorded.at.noise, site.channel(where), len(counts)).mean()))
        ends = {"low": float(counts.min()), "high": float(counts.max())}
        piled = [side for side in _SIDES if np.sum(np.abs(counts - ends[side]) < near) >= _AT_RAIL]
        return tuple(cls(site, where, {side: ends[side]}) for side in piled)

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        ends = {side: described.values[side].nominal for side in _SIDES if side in described.values}
        if not ends:
            raise MechanismError(
                f"the effect '{described.label}' of rig '{site.rig.name}' gives neither 'low_counts' nor "
                "'high_counts'; give the rail that counts stop at, or both"
            )
        if len(ends) == 2 and not ends["low"] < ends["high"]:
            raise MechanismError(
                f"the effect '{described.label}' of rig '{site.rig.name}' has low_counts = {ends['low']:g} and "
                f"high_counts = {ends['high']:g}, expected the lower first"
            )
        return cls(site, described.where, ends).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(
            Coefficient(side, "count", 20.0, start=self._ends[side])
            for side in _SIDES
            if side in self._ends
        )

    def coded(self, counts: Array, coefficients: Array, at: Circumstances) -> Coded | None:
        y, s = counts[:, self.channel], spread(at.noise, self.channel, len(counts))
        rails = dict(zip((c.name for c in self.coefficients), coefficients, strict=True))
        mean, slope, by = y, np.ones(len(y)), []
        for side, sign in (("low", 1.0), ("high", -1.0)):
            if side in rails:
                # A rail alone adds s g(-z), z = sign (y - rail) / s; two rails add up.
                z = sign * (y - rails[side]) / s
                beyond = below(-z)
                mean = mean + sign * s * (density(z) - z * beyond)
                slope = slope - beyond
                by.append(beyond)
        return Coded(self.channel, mean, slope, np.stack(by, axis=1))

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        gain, offset = (self.site.nominal(f"{self.where}.{part}") for part in ("gain", "offset"))
        zero = self.site.described(self.where).zero_count
        counts = (values[:, self.channel] - offset) / gain + zero
        beyond = [
            float(end - counts.min() if c.name == "low" else counts.max() - end)
            for c, end in zip(self.coefficients, coefficients, strict=True)
        ]
        return abs(gain) * max(0.0, *beyond)

    @property
    def dimension(self) -> str:
        return self.measures
