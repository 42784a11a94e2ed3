"""Cyclic redundancy checks of 16 bits, by the names of the catalogue. Pure.

    name           polynomial  start   reflected   check of "123456789"
    ccitt-false    0x1021      0xFFFF  no          0x29B1
    xmodem         0x1021      0x0000  no          0x31C3
    modbus         0x8005      0xFFFF  yes         0x4B37
    arc            0x8005      0x0000  yes         0xBB3D

Source: Cook, "Catalogue of parametrised CRC algorithms": CRC-16/IBM-3740 (ccitt-false),
CRC-16/XMODEM, CRC-16/MODBUS, CRC-16/ARC.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Crc16:
    """One algorithm.

    Attributes:
        start: register before the first byte.
        reflected: whether bytes go in lowest bit first.
        table: change of the register by each byte.
    """

    start: int
    reflected: bool
    table: tuple[int, ...]

    def of(self, data: bytes) -> int:
        """The check of ``data``."""
        crc = self.start
        for byte in data:
            if self.reflected:
                crc = crc >> 8 ^ self.table[(crc ^ byte) & 0xFF]
            else:
                crc = crc << 8 & 0xFFFF ^ self.table[crc >> 8 ^ byte]
        return crc


def _make(polynomial: int, start: int, *, reflected: bool) -> Crc16:
    table = []
    for byte in range(256):
        crc = byte if reflected else byte << 8
        for _ in range(8):
            if reflected:
                crc = crc >> 1 ^ (polynomial if crc & 1 else 0)
            else:
                crc = crc << 1 & 0xFFFF ^ (polynomial if crc & 0x8000 else 0)
        table.append(crc)
    return Crc16(start, reflected, tuple(table))


CRCS: Mapping[str, Crc16] = {
    "ccitt-false": _make(0x1021, 0xFFFF, reflected=False),
    "xmodem": _make(0x1021, 0x0000, reflected=False),
    "modbus": _make(0xA001, 0xFFFF, reflected=True),
    "arc": _make(0xA001, 0x0000, reflected=True),
}
