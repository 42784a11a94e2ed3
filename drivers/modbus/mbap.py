"""Modbus TCP frames of a master: requests to bytes, bytes to replies. Pure.

    transaction u16, protocol u16 = 0, length u16 = 1 + PDU, unit u8, PDU     all big-endian

A reply repeats its request's transaction: that proves that they belong together.
Source: Modbus Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import Malformed
from drivers.modbus.pdu import LONGEST_PDU, Identify, Read

HEADER = 7
LARGEST_TRANSACTION = 0xFFFF


@dataclass(frozen=True, slots=True)
class Adu:
    """A whole frame."""

    transaction: int
    unit: int
    pdu: bytes


def encode(request: Read | Identify, transaction: int) -> bytes:
    """The frame to send."""
    pdu = bytes([request.pdu.function_code]) + request.pdu.encode()
    head = transaction.to_bytes(2, "big") + bytes(2) + (1 + len(pdu)).to_bytes(2, "big")
    return head + bytes([request.unit]) + pdu


class AduBuffer:
    """Cuts the stream of a connection into frames."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Adu]:
        """The frames that ``data`` completes.

        Raises:
            Malformed: what follows cannot be a frame; where the next one begins is not known.
        """
        self._rest += data
        frames = []
        while len(self._rest) >= HEADER:
            head = self._rest
            protocol, length = int.from_bytes(head[2:4], "big"), int.from_bytes(head[4:6], "big")
            if protocol != 0 or not 2 <= length <= 1 + LONGEST_PDU:
                raise Malformed(f"{head[:HEADER].hex()} is no head of a Modbus TCP frame")
            end = HEADER - 1 + length
            if len(self._rest) < end:
                break
            pdu = self._rest[HEADER:end]
            frames.append(Adu(int.from_bytes(head[:2], "big"), head[6], pdu))
            self._rest = self._rest[end:]
        return frames
