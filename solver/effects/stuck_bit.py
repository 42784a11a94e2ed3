"""``stuck-bit``: one bit of a converter's code does not toggle, so that half of all codes are missing.

Its closure residual is a saw whose teeth are as fine as the bit, which is why it is looked for
in raw codes first; here it is what explains them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Quantity
from solver.effects.channel import ChannelEffect
from solver.effects.converter import Codes, expected, spread
from solver.effects.effect import Array, Coded, Coefficient, Recorded, Site
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances

_HIGHEST = 52


class StuckBit(ChannelEffect):
    """Bit ``bit`` of the code, 0 the lowest, in two's complement, always reads ``value``."""

    name = "stuck-bit"
    needs = ("noise",)
    scanned = True

    def __init__(self, site: Site, where: str, bit: int, value: int) -> None:
        super().__init__(site, where)
        self._bit, self._value = bit, value

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return converters(site)

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        """The bits that some pose's code would show stuck."""
        at_channel = site.described(where)
        low, high = at_channel.count_range or (0, 0)
        gain, offset = (site.nominal(f"{where}.{part}") for part in ("gain", "offset"))
        counts = (recorded.values[:, site.channel(where)] - offset) / gain + at_channel.zero_count
        width = max(abs(low), abs(high)).bit_length()
        forms = (cls(site, where, bit, value) for bit in range(width) for value in (0, 1))
        codes = np.round(counts).astype(np.int64)
        return tuple(form for form in forms if np.any(form.law(codes) != codes))

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        bit, value = (
            described.values.get(part, Quantity(0.0)).nominal for part in ("bit", "value")
        )
        if bit not in range(_HIGHEST + 1) or value not in (0, 1):
            raise MechanismError(
                f"the effect '{described.label}' of rig '{site.rig.name}' has bit = {bit:g}, value = {value:g}; "
                f"expected a bit from 0 to {_HIGHEST}, and the value 0 or 1"
            )
        return cls(site, described.where, int(bit), int(value)).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return ()

    @property
    def settings(self) -> Mapping[str, Quantity]:
        return {
            "bit": Quantity(float(self._bit), "ratio"),
            "value": Quantity(float(self._value), "ratio"),
        }

    def law(self, codes: Codes) -> Codes:
        """The code that comes out for each of ``codes``."""
        mask = np.int64(1 << self._bit)
        return codes | mask if self._value else codes & ~mask

    def coded(self, counts: Array, coefficients: Array, at: Circumstances) -> Coded | None:
        sigma = spread(at.noise, self.channel, len(counts))
        mean, _ = expected(counts[:, self.channel], sigma, self.law)
        # Between its jumps the code follows the reading; a search that saw the jumps would not end.
        return Coded(self.channel, mean, np.ones(len(counts)), np.zeros((len(counts), 0)))

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(abs(self.site.nominal(f"{self.where}.gain")) * (1 << self._bit))

    @property
    def dimension(self) -> str:
        return self.measures


def converters(site: Site) -> tuple[str, ...]:
    """Channels behind a converter: their counts have a range, and do not wrap."""
    return tuple(
        c.name for c in site.rig.channels if c.count_range is not None and c.modulus_counts is None
    )
