"""``crosstalk``: one channel of a device leaks into another, on a shared supply or converter."""

from __future__ import annotations

import numpy as np

from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.mechanism.circumstances import Circumstances

_ARROW = "<-"


class Crosstalk(Effect):
    """The counts of the first channel gain ratio times the counts, less zero_count, of the second.

    As values: delta = gain_1 ratio (v_2 - offset_2) / gain_2, with the gains and the offset that
    the rig states.
    """

    name = "crosstalk"

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        into, _, source = where.partition(_ARROW)
        self._into, self._source = site.channel(into), site.channel(source)
        self._scale = site.nominal(f"{into}.gain") / site.nominal(f"{source}.gain")
        self._offset = site.nominal(f"{source}.offset")

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return tuple(
            f"{into.name}{_ARROW}{source.name}"
            for into in site.rig.channels
            for source in site.rig.channels
            if into is not source and into.device is not None and into.device == source.device
        )

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("ratio", "ratio", 0.01, -0.5, 0.5),)

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        leak = (self._scale * (values[:, self._source] - self._offset))[:, None]
        by_values = np.zeros((len(values), 1, values.shape[1]))
        by_values[:, 0, self._source] = self._scale * coefficients[0]
        target = np.array([self._into], dtype=np.intp)
        return Shift(target, leak * coefficients[0], leak[:, :, None], by_values)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
