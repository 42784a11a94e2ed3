"""Requests of a Modbus master and what their replies say, without the frame around them. Pure.

PDUs are those of ``pymodbus``; its client is not used, because it takes a late reply for the
answer to the next request, sleeps while it waits, hides checksum errors, and opens a lost
port again by itself. Frames are `drivers.modbus.rtu`'s (serial) and `drivers.modbus.mbap`'s (TCP).

Source: Modbus Application Protocol V1.1b3, 6.3, 6.4, 6.21, 7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from pymodbus.constants import ExcCodes
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest

from drivers.errors import Malformed

READ_HOLDING, READ_INPUT, IDENTIFY = 3, 4, 43
EXCEPTION = 0x80
LONGEST_PDU = 253


@dataclass(frozen=True, slots=True)
class Read:
    """A request for ``count`` registers from ``address`` on, by function 3 or 4."""

    unit: int
    function: int
    address: int
    count: int

    @property
    def longest_reply(self) -> int:
        """Bytes of the reply's PDU."""
        return 2 + 2 * self.count

    @property
    def pdu(self) -> ModbusPDU:
        """As ``pymodbus`` encodes it."""
        kind = (
            ReadInputRegistersRequest
            if self.function == READ_INPUT
            else ReadHoldingRegistersRequest
        )
        return kind(address=self.address, count=self.count, dev_id=self.unit)


@dataclass(frozen=True, slots=True)
class Identify:
    """A request for the basic device identification (function 43/14); its reply varies in length."""

    unit: int
    function: int = IDENTIFY
    longest_reply: int = LONGEST_PDU

    @property
    def pdu(self) -> ModbusPDU:
        """As ``pymodbus`` encodes it."""
        return ReadDeviceInformationRequest(read_code=1, object_id=0, dev_id=self.unit)


class Verdict(Enum):
    """What a valid reply of our unit and function is to a request."""

    ANSWER = "answer"
    REFUSAL = "refusal"
    LATE = "late"


@dataclass(frozen=True, slots=True)
class Reply:
    """A valid reply.

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


def read_reply(pdu: bytes, request: Read | Identify) -> Reply:
    """What a whole reply PDU of the request's function says; raises Malformed."""
    if len(pdu) < 2 or pdu[0] & ~EXCEPTION != request.function:
        raise Malformed(f"unit {request.unit} answered {pdu.hex()} to function {request.function}")
    if pdu[0] & EXCEPTION:
        return Reply(Verdict.REFUSAL, exception=pdu[1])
    if isinstance(request, Identify):
        try:
            return Reply(Verdict.ANSWER, texts=tuple(_texts(pdu)))
        except IndexError as error:
            raise Malformed(f"unit {request.unit} identifies itself as {pdu.hex()}") from error
    body = pdu[2:]
    if len(body) != pdu[1]:
        raise Malformed(f"unit {request.unit} announced {pdu[1]} bytes and sent {len(body)}")
    if len(body) != 2 * request.count:
        return Reply(Verdict.LATE)
    values = (int.from_bytes(body[at : at + 2], "big") for at in range(0, len(body), 2))
    return Reply(Verdict.ANSWER, registers=tuple(values))


def _texts(pdu: bytes) -> Iterator[str]:
    at = 7
    for _ in range(pdu[6]):
        length = pdu[at + 1]
        yield pdu[at + 2 : at + 2 + length].decode("ascii", "replace")
        at += 2 + length
