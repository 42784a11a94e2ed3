"""Modbus RTU frames of a master: requests to bytes, bytes to replies. Pure.

Which bytes are a reply, and to which request, is decided here; CRC by ``pymodbus``:

    a reply to Read(unit, function, address, count) is a frame
        unit function 2*count data[2*count] crc     or
        unit function+128 exception-code crc
    with the right CRC, anywhere in what came since the request. What is around it is noise,
    the echo of a two-wire adapter, or the conversation of others, and is passed over.

A frame of our unit and function with another count is the late reply to another request.
Source: Modbus over Serial Line V1.02, 2.5.1.
"""

from __future__ import annotations

from collections.abc import Iterator

from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU

from drivers.modbus.pdu import EXCEPTION, IDENTIFY, Identify, Read, Reply, read_reply

CRC_BYTES = 2
AROUND = 1 + CRC_BYTES
"""Bytes of a frame around its PDU: unit and CRC."""

HEADER = 3
"""Bytes before the data of a register reply: unit, function, byte count."""


def encode(request: Read | Identify) -> bytes:
    """The frame to send."""
    return FramerRTU(DecodePDU(True)).buildFrame(request.pdu)


def replies(data: bytes, request: Read | Identify) -> Iterator[Reply]:
    """The valid frames in ``data`` that can be replies to ``request``, in order."""
    start = 0
    while start < len(data):
        length = _valid_length(data[start:], request)
        if length is None:
            start += 1
            continue
        yield read_reply(data[start + 1 : start + length - CRC_BYTES], request)
        start += length


def bytes_of_others(data: bytes, request: Read | Identify) -> int:
    """Bytes in ``data`` that are valid replies of other units to the function of ``request``."""
    start = found = 0
    while start + HEADER + CRC_BYTES <= len(data):
        theirs = data[start] != request.unit and data[start + 1] & ~EXCEPTION == request.function
        length = _length(data[start:]) if theirs else None
        if length is None or not _intact(data[start : start + length]):
            start += 1
            continue
        found += length
        start += length
    return found


def complete_but_damaged(data: bytes, request: Read | Identify) -> bool:
    """Whether ``data`` begins like the reply to ``request``, has its length, and is no valid frame."""
    if data[:2] != bytes([request.unit, request.function]):
        return False
    length = _length(data)
    return length is not None and len(data) >= length and not _intact(data[:length])


def _valid_length(data: bytes, request: Read | Identify) -> int | None:
    if len(data) < 2 or data[0] != request.unit or data[1] & ~EXCEPTION != request.function:
        return None
    length = _length(data)
    if length is None or len(data) < length or not _intact(data[:length]):
        return None
    return length


def _length(data: bytes) -> int | None:
    """Length of the frame at the beginning of ``data``, None where it is not known yet."""
    if data[1] & EXCEPTION:
        return HEADER + CRC_BYTES
    if data[1] != IDENTIFY:
        return HEADER + data[2] + CRC_BYTES if len(data) >= HEADER else None
    if len(data) < 8:
        return None
    at = 8
    for _ in range(data[7]):
        if len(data) < at + 2:
            return None
        at += 2 + data[at + 1]
    return at + CRC_BYTES


def _intact(frame: bytes) -> bool:
    check = int.from_bytes(frame[-CRC_BYTES:], "big")
    return len(frame) > CRC_BYTES and FramerRTU.check_CRC(frame[:-CRC_BYTES], check)
