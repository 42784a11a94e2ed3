"""Modbus RTU frames of a master: requests to bytes, bytes to replies. Pure.

PDUs and CRC are those of ``pymodbus``; its client is not used, because it takes a late reply
for the answer to the next request, sleeps while it waits, hides checksum errors, and opens
a lost port again by itself. Which bytes are a reply, and to which request, is decided here:

    a reply to Read(unit, function, address, count) is a frame
        unit function 2*count data[2*count] crc     or
        unit function+128 exception-code crc
    with the right CRC, anywhere in what came since the request. What is around it is noise,
    the echo of a two-wire adapter, or the conversation of others, and is passed over.

A frame of our unit and function with another count is the late reply to another request.
Sources: Modbus Application Protocol V1.1b3, 6.3, 6.4, 6.21, 7; Modbus over Serial Line V1.02, 2.5.1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest

READ_HOLDING, READ_INPUT, IDENTIFY = 3, 4, 43
EXCEPTION = 0x80
LONGEST_FRAME = 256
CRC_BYTES = 2
HEADER = 3
"""Bytes before the data of a register reply: unit, function, byte count."""


@dataclass(frozen=True, slots=True)
class Read:
    """A request for ``count`` registers from ``address`` on, by function 3 or 4."""

    unit: int
    function: int
    address: int
    count: int

    @property
    def longest_reply(self) -> int:
        """Bytes of the reply."""
        return HEADER + 2 * self.count + CRC_BYTES

    def encode(self) -> bytes:
        """The frame to send."""
        kind = (
            ReadInputRegistersRequest
            if self.function == READ_INPUT
            else ReadHoldingRegistersRequest
        )
        return _frame(kind(address=self.address, count=self.count, dev_id=self.unit))


@dataclass(frozen=True, slots=True)
class Identify:
    """A request for the basic device identification (function 43/14); its reply varies in length."""

    unit: int
    function: int = IDENTIFY
    longest_reply: int = LONGEST_FRAME

    def encode(self) -> bytes:
        """The frame to send."""
        return _frame(ReadDeviceInformationRequest(read_code=1, object_id=0, dev_id=self.unit))


class Verdict(Enum):
    """What a valid frame of our unit and function is to a request."""

    ANSWER = "answer"
    REFUSAL = "refusal"
    LATE = "late"


@dataclass(frozen=True, slots=True)
class Reply:
    """A valid frame.

    Attributes:
        verdict: what it is to the request.
        registers: values, 0 to 65,535 each; of an identification, its texts in ``texts``.
        exception: exception code of a refusal, else 0.
    """

    verdict: Verdict
    registers: tuple[int, ...] = ()
    texts: tuple[str, ...] = ()
    exception: int = 0

    @property
    def exception_text(self) -> str:
        """The exception in words."""
        known = {code.value: code.name.lower().replace("_", " ") for code in ExcCodes}
        return f"Modbus exception {self.exception} ({known.get(self.exception, 'unknown')})"


def replies(data: bytes, request: Read | Identify) -> Iterator[Reply]:
    """The valid frames in ``data`` that can be replies to ``request``, in order."""
    start = 0
    while start < len(data):
        length = _valid_length(data[start:], request)
        if length is None:
            start += 1
            continue
        yield _reply(data[start : start + length], request)
        start += length


def complete_but_damaged(data: bytes, request: Read | Identify) -> bool:
    """Whether ``data`` begins like the reply to ``request``, has its length, and is no valid frame."""
    if data[:2] != bytes([request.unit, request.function]):
        return False
    length = _length(data)
    return length is not None and len(data) >= length and not _intact(data[:length])


def _frame(request: ModbusPDU) -> bytes:
    return FramerRTU(DecodePDU(True)).buildFrame(request)


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


def _reply(frame: bytes, request: Read | Identify) -> Reply:
    if frame[1] & EXCEPTION:
        return Reply(Verdict.REFUSAL, exception=frame[2])
    if isinstance(request, Identify):
        return Reply(Verdict.ANSWER, texts=tuple(_texts(frame)))
    body = frame[HEADER:-CRC_BYTES]
    if len(body) != 2 * request.count:
        return Reply(Verdict.LATE)
    values = (int.from_bytes(body[at : at + 2], "big") for at in range(0, len(body), 2))
    return Reply(Verdict.ANSWER, registers=tuple(values))


def _texts(frame: bytes) -> Iterator[str]:
    at = 8
    for _ in range(frame[7]):
        length = frame[at + 1]
        yield frame[at + 2 : at + 2 + length].decode("ascii", "replace")
        at += 2 + length
