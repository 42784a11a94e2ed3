"""``gain-error``: a channel's scale is not the nominal one."""

from __future__ import annotations

import numpy as np

from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.mechanism.circumstances import Circumstances


class GainError(Effect):
    """The gain is (1 + ratio) times the stated one.

    The channel sees offset + (v - offset) / (1 + ratio): a sensor's sensitivity, a reference
    voltage or a gear ratio that differs from the data sheet's.
    """

    name = "gain-error"

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        self._channel = np.array([site.channel(where)], dtype=np.intp)
        self._offset = site.nominal(f"{where}.offset")

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        free = {p.name for p in site.table if p.identify or p.tie is not None}
        return tuple(c.name for c in site.rig.channels if f"{c.name}.gain" not in free)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("ratio", "ratio", 0.01, -0.5, 0.5),)

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        scale = 1.0 / (1.0 + coefficients[0])
        beyond = values[:, self._channel] - self._offset
        by_values = np.zeros((len(values), 1, values.shape[1]))
        by_values[:, 0, self._channel[0]] = scale - 1.0
        return Shift(
            self._channel, (scale - 1.0) * beyond, (-(scale**2) * beyond)[:, :, None], by_values
        )

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
