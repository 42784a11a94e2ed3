"""Where a signal is in a CAN frame, by the rules of DBC files: bits to raw value and back. Pure.

Raw values are integers as they are on the wire; a DBC's factor and offset are not applied.

    Intel (little-endian)    the start bit is the lowest; bit n is bit n mod 8 of byte n div 8,
                             and the value grows towards higher bit numbers
    Motorola (big-endian)    the start bit, numbered the same way, is the highest; the value goes
                             down to bit 0 of its byte, then on at bit 7 of the next byte

Source: Vector, "DBC File Format Documentation", signal definitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.errors import Malformed


class Block:
    """Frames of one size, each a word of 64 bits in either byte order, zeros behind its data.

    Args:
        frames: their data, of ``size`` bytes each.
        size: at most `WORD`.
    """

    WORD: ClassVar[int] = 8

    def __init__(self, frames: Sequence[bytes], size: int) -> None:
        self.size = size
        padded = np.zeros((len(frames), self.WORD), np.uint8)
        padded[:, :size] = np.frombuffer(b"".join(frames), np.uint8).reshape(len(frames), size)
        self.little: NDArray[np.uint64] = padded.view("<u8")[:, 0]
        self.big: NDArray[np.uint64] = padded.view(">u8")[:, 0].astype(np.uint64)


@dataclass(frozen=True, slots=True)
class SignalLayout:
    """One signal.

    Attributes:
        name: as in the DBC.
        start: start bit, as in the DBC.
        length: bits.
        little_endian: byte order.
        signed: whether the raw value is in two's complement.
    """

    name: str
    start: int
    length: int
    little_endian: bool
    signed: bool

    def raw(self, data: bytes) -> int:
        """Raw value in a frame's ``data``; raises Malformed where the frame is too short for it."""
        length = self.length
        if self.little_endian and self.start + length <= 8 * len(data):
            value = int.from_bytes(data, "little") >> self.start
        else:
            value = int.from_bytes(data, self._order) >> self._shift(len(data))
        value &= (1 << length) - 1
        if self.signed and value >> (length - 1):
            value -= 1 << length
        return value

    def column(self, block: Block) -> list[int]:
        """`raw` of all frames of ``block`` at once; raises Malformed."""
        values: NDArray[np.uint64 | np.int64]
        if self.little_endian:
            values = block.little >> np.uint64(self._shift(block.size))
        else:
            behind = 8 * (Block.WORD - block.size)
            values = block.big >> np.uint64(self._shift(block.size) + behind)
        values &= np.uint64(self._mask)
        if self.signed:
            unused = np.int64(64 - self.length)
            values = (values.view(np.int64) << unused) >> unused
        column: list[int] = values.tolist()
        return column

    def put(self, value: int, data: bytes) -> bytes:
        """``data`` with the raw ``value`` in place; raises ValueError where it does not fit."""
        low, high = self.limits
        if not low <= value <= high:
            raise ValueError(f"{self.name} is {value}, expected {low} to {high}")
        shift = self._shift(len(data))
        cleared = int.from_bytes(data, self._order) & ~(self._mask << shift)
        return (cleared | (value & self._mask) << shift).to_bytes(len(data), self._order)

    @property
    def limits(self) -> tuple[int, int]:
        """Lowest and highest raw value."""
        if self.signed:
            return -(1 << (self.length - 1)), (1 << (self.length - 1)) - 1
        return 0, self._mask

    @property
    def _mask(self) -> int:
        return (1 << self.length) - 1

    @property
    def _order(self) -> Literal["little", "big"]:
        return "little" if self.little_endian else "big"

    def _shift(self, size: int) -> int:
        """How far the lowest bit is above bit 0 of the whole frame, read in the signal's order."""
        first = self.start if self.little_endian else 8 * (self.start // 8) + 7 - self.start % 8
        end = first + self.length
        if end > 8 * size:
            raise Malformed(
                f"a frame of {size} bytes, but the signal {self.name} ends at bit {end - 1}"
            )
        return first if self.little_endian else 8 * size - end
