"""``offset-jump``: the zero of a channel moves at one moment: lost counts, a coupling that slipped."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Quantity
from solver.effects.channel import ChannelEffect
from solver.effects.effect import Array, Coefficient, Recorded, Shift, Site
from solver.effects.moments import between, looked_at, no_moment
from solver.mechanism.circumstances import Circumstances


class OffsetJump(ChannelEffect):
    """delta = step from t = at on."""

    name = "offset-jump"
    needs = ("time_s",)
    scanned = True

    def __init__(self, site: Site, where: str, at_s: float) -> None:
        super().__init__(site, where)
        self._at_s = at_s

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        return no_moment(at)

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        return tuple(cls(site, where, moment) for moment in looked_at(recorded.at))

    def closer(self, recorded: Recorded) -> tuple[Self, ...]:
        return tuple(
            type(self)(self.site, self.where, moment) for moment in between(self._at_s, recorded.at)
        )

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        moment = described.values.get("at", Quantity()).nominal
        return cls(site, described.where, moment).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("step", self.measures, self.of_size(5e-3, 5e-4)),)

    @property
    def settings(self) -> Mapping[str, Quantity]:
        return {"at": Quantity(self._at_s, "time")}

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        if at.time_s is None:
            return None
        after = np.where(at.time_s >= self._at_s, 1.0, 0.0)
        return self.shift(after[:, None], coefficients)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
