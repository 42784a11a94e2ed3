"""``nonlinearity``: a channel departs smoothly from a straight line, as RVDTs and LVDTs do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from numpy.polynomial import legendre

from recordings.rig import DescribedEffect, Quantity
from solver.effects.effect import Array, Coefficient, Effect, Recorded, Shift, Site
from solver.mechanism.circumstances import Circumstances

_DEGREES = (3, 5, 8)  # highest order of the forms that are tried
_PLAUSIBLE = 0.01  # of the range used
_MARGIN = 0.02  # of the range used, beyond it on both sides


class Nonlinearity(Effect):
    """delta = sum p_n P_n(x), n = 1 ... degree, Legendre polynomials over [low, high].

    Order 0 is the channel's offset and is left to it; so is order 1 where the gain is identified.
    Where it is held, a bend that averages out over full scale still has a slope over the part
    that is used. A transducer bends gently: higher orders are expected to be smaller, which the
    plausible sizes say.
    """

    name = "nonlinearity"
    scanned = True
    local = True

    def __init__(
        self, site: Site, where: str, low: float, high: float, orders: Sequence[int]
    ) -> None:
        super().__init__(site, where)
        self._orders = tuple(orders)
        self._channel = np.array([site.channel(where)], dtype=np.intp)
        self._low, self._high = low, high

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return tuple(site.spans)

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        used = recorded.values[:, site.channel(where)]
        low, high = float(used.min()), float(used.max())
        margin = _MARGIN * (high - low)
        if not high > low:
            return ()
        gain = site.table[site.parameter(f"{where}.gain")]
        first = 2 if gain.identify or gain.tie is not None else 1
        return tuple(
            cls(site, where, low - margin, high + margin, range(first, highest + 1))
            for highest in _DEGREES
        )

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        low, high = (described.values.get(end, Quantity()).nominal for end in ("low", "high"))
        orders = [int(p[1:]) for p in described.values if p[0] == "p" and p[1:].isdigit()]
        return cls(site, described.where, low, high, sorted(orders) or [2]).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        dimension, wide = self.site.dimension(self.where), self._high - self._low
        return tuple(
            Coefficient(f"p{n}", dimension, _PLAUSIBLE * wide * 2.0 / max(n, 2))
            for n in self._orders
        )

    @property
    def settings(self) -> Mapping[str, Quantity]:
        dimension = self.site.dimension(self.where)
        return {"low": Quantity(self._low, dimension), "high": Quantity(self._high, dimension)}

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        scale = 2.0 / (self._high - self._low)
        x = scale * (values[:, self._channel[0]] - self._low) - 1.0
        orders = list(self._orders)
        shapes = np.asarray(legendre.legvander(x, orders[-1])[:, orders], dtype=np.float64)
        series = np.zeros(orders[-1] + 1)
        series[orders] = coefficients
        by_values = np.zeros((len(values), 1, values.shape[1]))
        by_values[:, 0, self._channel[0]] = scale * legendre.legval(x, legendre.legder(series))
        return Shift(self._channel, (shapes @ coefficients)[:, None], shapes[:, None, :], by_values)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        shift = self.seen(values, coefficients, at)
        assert shift is not None
        used = values[:, self._channel[0]]
        line = np.polynomial.Polynomial.fit(used, shift.amount[:, 0], 1)
        return float(np.sqrt(np.mean((shift.amount[:, 0] - line(used)) ** 2)))
