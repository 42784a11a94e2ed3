"""``stuck-bit``: one bit of a converter's code does not toggle.

Codes are integers in two's complement; bit 0 is the lowest. Size: the weight of the bit in the
channel's unit [deg or m], of which the nearest bit is taken; whether it is stuck at 0 or 1 is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Channel, DescribedEffect, Rig
from sim_devices.plant.effects.described import channel_names, check_place, read_values
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.errors import BadEffect

_HIGHEST = 52


class StuckBit(Effect):
    """A bit that always reads the same.

    Args:
        where: channel.
        size: weight of the bit [``unit``].
        unit: "deg" or "m".
        bit: from 0, the lowest.
        value: 0 or 1.
    """

    name = "stuck-bit"

    def __init__(self, where: str, size: float, unit: str, bit: int, value: int) -> None:
        super().__init__(where, size, unit)
        self._mask = np.int64(1 << bit)
        self._value = value

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return converters(rig)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        channel = rig.channel(where)
        bit = int(rng.integers(1, max(2, _width(channel) // 2)))
        return repr(abs(channel.gain.nominal) * 2**bit / channel_unit(rig, where)[1])

    @classmethod
    def make(cls, request: Request) -> Self:
        channel = request.rig.channel(request.where)
        unit, to_si = channel_unit(request.rig, request.where)
        size = number_size(cls.name, request.size, unit, most=1e6)
        count = abs(channel.gain.nominal) / to_si
        bit, highest = round(np.log2(size / count)), _width(channel) - 1
        if not 0 <= bit <= highest:
            raise BadEffect(
                f"the size of '{cls.name}' is '{request.size}', expected the weight of a bit of "
                f"'{request.where}': {count:.4g} {unit} (bit 0) to {count * 2**highest:.4g} {unit} (bit {highest})"
            )
        return cls(request.where, count * 2**bit, unit, bit, int(request.rng.integers(2)))

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, channel_names(rig))
        true = read_values(effect, values, {}, {"bit": "ratio", "value": "ratio"})
        bit, value = true["bit"], true["value"]
        if bit not in range(_HIGHEST + 1) or value not in (0, 1):
            raise BadEffect(
                f"the effect '{effect.label}' has bit = {bit:g}, value = {value:g}, expected a bit from 0 "
                f"to {_HIGHEST} and the value 0 or 1"
            )
        unit, to_si = channel_unit(rig, effect.where)
        weight = abs(rig.channel(effect.where).gain.nominal) * 2 ** int(bit) / to_si
        return cls(effect.where, weight, unit, int(bit), int(value))

    def counts(self, channel: str, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        if channel != self.where:
            return counts
        return counts | self._mask if self._value else counts & ~self._mask


def converters(rig: Rig) -> tuple[str, ...]:
    """Channels behind a converter: counts that have a range and do not wrap."""
    return tuple(
        c.name for c in rig.channels if c.count_range is not None and c.modulus_counts is None
    )


def _width(channel: Channel) -> int:
    """Bits of a converter's code."""
    low, high = channel.count_range or (0, 1)
    return int(max(abs(low), abs(high))).bit_length()
