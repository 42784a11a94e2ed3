"""Consistent Overhead Byte Stuffing: packets in a byte stream, each ended by a zero byte. Pure.

A packet is cut at its zero bytes; each piece of up to 254 bytes is preceded by its length plus
one (255 says that no zero follows). So no byte of an encoded packet is zero, and whoever joins
in the middle of a stream, or has lost bytes, is in step again after the next zero.

Source: Cheshire & Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999.
"""

from __future__ import annotations

DELIMITER = b"\0"
LONGEST_PIECE = 254


def decode(encoded: bytes) -> bytes:
    """The packet in ``encoded`` (without its delimiter); raises ValueError where it is none."""
    packet = bytearray()
    at = 0
    while at < len(encoded):
        code = encoded[at]
        piece = encoded[at + 1 : at + code]
        if code == 0 or 0 in piece:
            raise ValueError("a zero inside a COBS packet")
        if len(piece) != code - 1:
            raise ValueError(f"a COBS packet ends after {len(piece)} of {code - 1} bytes")
        packet += piece
        at += code
        if code <= LONGEST_PIECE and at < len(encoded):
            packet.append(0)
    return bytes(packet)


class PacketBuffer:
    """Cuts a stream into encoded packets. The first, which may have begun earlier, is dropped.

    Args:
        longest: bytes of the longest encoded packet; what is longer is given as it is, cut off.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._rest = b""
        self._in_step = False

    def feed(self, data: bytes) -> list[bytes]:
        """The packets that ``data`` completes; empty ones (a repeated delimiter) are passed over."""
        *packets, self._rest = (self._rest + data).split(DELIMITER)
        if packets and not self._in_step:
            self._in_step = True
            packets = packets[1:]
        if len(self._rest) > self._longest:
            if self._in_step:
                packets.append(self._rest)
            self._rest = b""
            self._in_step = False
        return [packet for packet in packets if packet]

    def reset(self) -> None:
        """The stream begins anew, anywhere."""
        self._rest = b""
        self._in_step = False
