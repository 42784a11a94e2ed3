"""Numbers in Modbus registers: 16 or 32 bits, signed or not, in any order of bytes. Pure.

Order names where the bytes A (highest) to D (lowest) of a number are, registers in order of
their addresses, the high byte of a register first: "ABCD" is big-endian, "CDAB" has the low
word first, "BADC" has the bytes of each register swapped, "DCBA" is little-endian. Of a 16-bit
number only the order of bytes within the register counts: swapped in "BADC" and "DCBA".
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

NumberType = Literal["uint16", "int16", "uint32", "int32", "float32"]
Order = Literal["ABCD", "CDAB", "BADC", "DCBA"]


@dataclass(frozen=True, slots=True)
class Register:
    """A number in one register or two.

    Attributes:
        address: of its first register.
        type: what it is.
        order: of its bytes.
    """

    address: int
    type: NumberType
    order: Order = "ABCD"

    @property
    def count(self) -> int:
        """Registers that it takes."""
        return 1 if self.type.endswith("16") else 2

    @property
    def addresses(self) -> range:
        """Its registers."""
        return range(self.address, self.address + self.count)

    @property
    def bits(self) -> int:
        """Width of the number."""
        return 16 * self.count

    def data(self, registers: Sequence[int]) -> bytes:
        """Its bytes, highest first, from the values of its registers."""
        words = [value.to_bytes(2, "big") for value in registers]
        if self.order in ("BADC", "DCBA"):
            words = [word[::-1] for word in words]
        if self.order in ("CDAB", "DCBA"):
            words.reverse()
        return b"".join(words)

    def integer(self, registers: Sequence[int]) -> int:
        """The integer in the values of its registers."""
        return int.from_bytes(self.data(registers), "big", signed=self.type.startswith("int"))

    def counts(self, registers: Sequence[int], resolution: float) -> int | None:
        """The number in counts: of a float, the nearest multiple of ``resolution``; None for no number."""
        if self.type != "float32":
            return self.integer(registers)
        (value,) = struct.unpack(">f", self.data(registers))
        return round(value / resolution) if math.isfinite(value) else None
