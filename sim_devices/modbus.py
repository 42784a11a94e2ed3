"""A Modbus server (slave): bytes in, bytes out, told the time; RTU on a serial line.

Owns function codes and exceptions (`Functions`), RTU framing and CRC (`RtuServer`); what the
registers mean is a `RegisterMap`. Knows no port and no clock.

    function     request -> answer
    3, 4         read holding, input registers, 1..125 of them
    6            write one holding register, echoed
    16           write 1..123 holding registers
    43 / 14      read device identification, basic objects
    exceptions   1 illegal function, 2 illegal data address, 3 illegal data value

A frame ends where its function's length is complete and the CRC fits, or with a silence of
`SILENCE_S`: then everything since the last silence is one frame. Frames with a wrong CRC and
frames for other units are counted and not answered. A broadcast (unit 0) is obeyed and not
answered.

Sources: Modbus over Serial Line V1.02, 2.5.1 (RTU framing, CRC); Modbus Application Protocol
V1.1b3, 6 (functions) and 7 (exceptions).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from sim_devices.errors import SimDevicesError

SILENCE_S = 0.010
"""Silence that ends a frame. The standard's 1.75 ms would take a busy computer for silence."""

LONGEST_FRAME = 256
MOST_READ = 125
MOST_WRITTEN = 123
BROADCAST = 0

READ_HOLDING, READ_INPUT, WRITE_SINGLE, WRITE_MULTIPLE, ENCAPSULATED = 3, 4, 6, 16, 43
READ_DEVICE_IDENTIFICATION = 14
BASIC, REGULAR, EXTENDED, INDIVIDUAL = 1, 2, 3, 4
CONFORMITY_BASIC_INDIVIDUAL = 0x81

FIXED_LENGTHS = {1: 8, 2: 8, 3: 8, 4: 8, 5: 8, 6: 8, 7: 4, 8: 8, 11: 4, 12: 4, 17: 4, 43: 7}
"""Length of a whole request by function, unit and CRC included, where it does not vary."""


class ExceptionCode(IntEnum):
    """Why a request is refused."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_DATA_ADDRESS = 2
    ILLEGAL_DATA_VALUE = 3


class RequestRefused(SimDevicesError):
    """A request that gets an exception response."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(f"refused with Modbus exception {code.value} ({code.name})")
        self.code = code


class RegisterMap(Protocol):
    """The registers of a device. Values are 16-bit, unsigned; addresses count from 0."""

    def read_holding(self, address: int, count: int, time_s: float) -> Sequence[int]:
        """Holding registers; raises RequestRefused."""

    def read_input(self, address: int, count: int, time_s: float) -> Sequence[int]:
        """Input registers; raises RequestRefused."""

    def write_holding(self, address: int, values: Sequence[int]) -> None:
        """Write holding registers, all or none; raises RequestRefused."""

    def identification(self) -> Mapping[int, str]:
        """Basic device identification: 0 vendor, 1 product code, 2 revision."""


def crc16(data: bytes) -> int:
    """CRC of a frame: polynomial 0xA001 reflected, start 0xFFFF; sent low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
    return byte


CRC_TABLE = tuple(_crc_of_byte(byte) for byte in range(256))


@dataclass(slots=True)
class LineCounts:
    """What a server has met on its line."""

    requests: int = 0
    bad_frames: int = 0
    foreign: int = 0


class Functions:
    """The function codes of one device: a request's PDU in, its answer's out."""

    def __init__(self, registers: RegisterMap) -> None:
        self._registers = registers

    def answer(self, pdu: bytes, time_s: float) -> bytes:
        """The answer, which may be an exception; ``pdu`` has at least its function code."""
        function = pdu[0]
        try:
            return bytes([function]) + self._obey(function, pdu[1:], time_s)
        except RequestRefused as refused:
            return bytes([function | 0x80, refused.code])

    def _obey(self, function: int, body: bytes, time_s: float) -> bytes:
        if function in (READ_HOLDING, READ_INPUT):
            address, count = _two_words(body)
            if not 1 <= count <= MOST_READ:
                raise RequestRefused(ExceptionCode.ILLEGAL_DATA_VALUE)
            _check_range(address, count)
            holding = function == READ_HOLDING
            read = self._registers.read_holding if holding else self._registers.read_input
            values = read(address, count, time_s)
            return bytes([2 * count]) + b"".join(value.to_bytes(2, "big") for value in values)
        if function == WRITE_SINGLE:
            address, value = _two_words(body)
            self._registers.write_holding(address, [value])
            return body
        if function == WRITE_MULTIPLE:
            return self._write_multiple(body)
        if function == ENCAPSULATED:
            return self._identify(body)
        raise RequestRefused(ExceptionCode.ILLEGAL_FUNCTION)

    def _write_multiple(self, body: bytes) -> bytes:
        address, count = _two_words(body[:4])
        data = body[5:]
        if not 1 <= count <= MOST_WRITTEN or len(data) != 2 * count or body[4] != len(data):
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_VALUE)
        _check_range(address, count)
        values = [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]
        self._registers.write_holding(address, values)
        return body[:4]

    def _identify(self, body: bytes) -> bytes:
        if body[:1] != bytes([READ_DEVICE_IDENTIFICATION]):
            raise RequestRefused(ExceptionCode.ILLEGAL_FUNCTION)
        if len(body) != 3 or body[1] not in (BASIC, REGULAR, EXTENDED, INDIVIDUAL):
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_VALUE)
        level, first = body[1], body[2]
        objects = self._registers.identification()
        if level == INDIVIDUAL:
            if first not in objects:
                raise RequestRefused(ExceptionCode.ILLEGAL_DATA_ADDRESS)
            wanted = [first]
        else:
            # As the standard asks: an unknown first object means the first of all.
            wanted = [number for number in objects if number >= first or first not in objects]
        head = [READ_DEVICE_IDENTIFICATION, level, CONFORMITY_BASIC_INDIVIDUAL, 0, 0, len(wanted)]
        texts = [(number, objects[number].encode("ascii")) for number in wanted]
        return bytes(head) + b"".join(bytes([n, len(text)]) + text for n, text in texts)


class RtuServer:
    """One unit on the line.

    Attributes:
        unit_id: 1..247.
        counts: requests obeyed or refused, frames with a wrong CRC, requests for other units.
    """

    def __init__(self, unit_id: int, registers: RegisterMap) -> None:
        self.unit_id = unit_id
        self.counts = LineCounts()
        self._functions = Functions(registers)
        self._buffer = bytearray()
        self._heard_s = 0.0

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes from the line, in pieces of any size; returns what to answer."""
        answer = self.tick(time_s)
        self._heard_s = time_s
        self._buffer += data
        while (length := request_length(self._buffer)) is not None:
            frame = bytes(self._buffer[:length])
            if len(frame) < length or not _intact(frame):
                break
            del self._buffer[:length]
            answer += self._serve(frame, time_s)
        if len(self._buffer) > LONGEST_FRAME:
            # Babble: keep no more than shows, at the next silence, that it is no frame.
            del self._buffer[LONGEST_FRAME + 1 :]
        return answer

    def tick(self, time_s: float) -> bytes:
        """Let time pass: a silence ends the frame under way; returns what to answer."""
        if not self._buffer or time_s - self._heard_s < SILENCE_S:
            return b""
        frame = bytes(self._buffer)
        self._buffer.clear()
        if len(frame) > LONGEST_FRAME or not _intact(frame):
            self.counts.bad_frames += 1
            return b""
        return self._serve(frame, time_s)

    def hang_up(self) -> None:
        """The host has let go of the port: a frame under way is forgotten."""
        self._buffer.clear()

    def _serve(self, frame: bytes, time_s: float) -> bytes:
        unit = frame[0]
        if unit not in (self.unit_id, BROADCAST):
            self.counts.foreign += 1
            return b""
        self.counts.requests += 1
        answer = self._functions.answer(frame[1:-2], time_s)
        if unit == BROADCAST:
            return b""
        answer = bytes([unit]) + answer
        return answer + crc16(answer).to_bytes(2, "little")


def request_length(data: bytes | bytearray) -> int | None:
    """Length of the whole request that ``data`` begins; None where that is not yet known.

    It never is for a function whose requests vary in length and that is not served here: such
    a request ends with silence.
    """
    if len(data) < 2:
        return None
    if data[1] == WRITE_MULTIPLE:
        return 9 + data[6] if len(data) > 6 else None
    return FIXED_LENGTHS.get(data[1])


def _intact(frame: bytes) -> bool:
    return len(frame) >= 4 and crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


def _two_words(body: bytes) -> tuple[int, int]:
    if len(body) != 4:
        raise RequestRefused(ExceptionCode.ILLEGAL_DATA_VALUE)
    return int.from_bytes(body[:2], "big"), int.from_bytes(body[2:], "big")


def _check_range(address: int, count: int) -> None:
    if address + count > 0x1_0000:
        raise RequestRefused(ExceptionCode.ILLEGAL_DATA_ADDRESS)
