"""The Modbus RTU server, against the frames printed in the Modbus standards and their like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_devices.modbus import (
    SILENCE_S,
    ExceptionCode,
    RequestRefused,
    RtuServer,
    crc16,
)


class Registers:
    """Input and holding registers 0 .. 499 with given values; 0x1234 is no legal value."""

    def __init__(self, values: Mapping[int, int] | None = None) -> None:
        self.values = dict.fromkeys(range(500), 0) | dict(values or {})

    def read_holding(self, address: int, count: int, time_s: float) -> Sequence[int]:
        if not all(register in self.values for register in range(address, address + count)):
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        return [self.values[register] for register in range(address, address + count)]

    def read_input(self, address: int, count: int, time_s: float) -> Sequence[int]:
        return [value ^ 0xFFFF for value in self.read_holding(address, count, time_s)]

    def write_holding(self, address: int, values: Sequence[int]) -> None:
        self.read_holding(address, len(values), 0.0)
        if 0x1234 in values:
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_VALUE)
        self.values.update(enumerate(values, address))

    def identification(self) -> Mapping[int, str]:
        return {0: "loopcal virtual", 1: "adc", 2: "1.0"}


def framed(text: str) -> bytes:
    body = bytes.fromhex(text)
    return body + crc16(body).to_bytes(2, "little")


@pytest.mark.parametrize(
    ("frame", "crc"),
    [
        # Modbus over Serial Line V1.02, 6.2.2: CRC of 02 07 is 0x1241, sent 41 12.
        ("02 07", "41 12"),
        ("11 03 00 6B 00 03", "76 87"),
        ("11 06 00 01 00 03", "9A 9B"),
        ("11 10 00 01 00 02 04 00 0A 01 02", "C6 F0"),
        ("11 10 00 01 00 02", "12 98"),
        ("01 04 02 FF FF", "B8 80"),
        ("11 04 02 00 0A", "F8 F4"),
        ("0A 81 02", "B0 53"),
    ],
)
def test_crc_of_published_frames(frame: str, crc: str) -> None:
    assert crc16(bytes.fromhex(frame)).to_bytes(2, "little") == bytes.fromhex(crc)


# Requests and answers of Modbus Application Protocol V1.1b3, chapter 6, for unit 0x11.
EXCHANGES = [
    ("11 03 00 6B 00 03", "11 03 06 02 2B 00 00 00 64"),
    ("11 04 00 08 00 01", "11 04 02 00 0A"),
    ("11 06 00 01 00 03", "11 06 00 01 00 03"),
    ("11 10 00 01 00 02 04 00 0A 01 02", "11 10 00 01 00 02"),
    # Exceptions: function, address beyond the map, count of 0 and of 126, value, byte count.
    ("11 01 04 A1 00 01", "11 81 01"),
    ("11 03 01 F4 00 01", "11 83 02"),
    ("11 04 FF FF 00 02", "11 84 02"),
    ("11 03 00 00 00 00", "11 83 03"),
    ("11 03 00 00 00 7E", "11 83 03"),
    ("11 06 01 F4 00 01", "11 86 02"),
    ("11 06 00 01 12 34", "11 86 03"),
    ("11 10 00 01 00 02 02 00 0A", "11 90 03"),
    ("11 10 FF FF 00 02 04 00 0A 01 02", "11 90 02"),
    # Device identification: basic stream, one object, none such, no such level, other MEI.
    (
        "11 2B 0E 01 00",
        "11 2B 0E 01 81 00 00 03 00 0F"
        + b"loopcal virtual".hex()
        + "01 03"
        + b"adc".hex()
        + "02 03"
        + b"1.0".hex(),
    ),
    ("11 2B 0E 04 01", "11 2B 0E 04 81 00 00 01 01 03" + b"adc".hex()),
    ("11 2B 0E 04 07", "11 AB 02"),
    ("11 2B 0E 05 00", "11 AB 03"),
    ("11 2B 0D 01 00", "11 AB 01"),
]


@pytest.fixture
def server() -> RtuServer:
    values = {0x6B: 0x022B, 0x6C: 0, 0x6D: 0x64, 8: 0xFFFF ^ 0x000A}
    return RtuServer(0x11, Registers(values))


@pytest.mark.parametrize(("request_", "answer"), EXCHANGES)
def test_exchange(server: RtuServer, request_: str, answer: str) -> None:
    assert server.receive(framed(request_), 0.0) == framed(answer)


@pytest.mark.parametrize(("request_", "answer"), EXCHANGES)
def test_exchange_byte_by_byte(server: RtuServer, request_: str, answer: str) -> None:
    answers = [server.receive(bytes([byte]), 0.001 * n) for n, byte in enumerate(framed(request_))]
    assert not any(answers[:-1])
    assert answers[-1] == framed(answer)


@pytest.mark.parametrize(("request_", "answer"), EXCHANGES)
def test_exchange_with_bytes_behind_it(server: RtuServer, request_: str, answer: str) -> None:
    assert server.receive(framed(request_) + b"\x11\x03", 0.0) == framed(answer)
    # What came behind is a frame of its own, and no good one, once silence ends it.
    assert server.receive(framed(request_), 1.0) == framed(answer)
    assert server.counts.bad_frames == 1


@pytest.mark.parametrize("at", range(8))
def test_wrong_crc_gets_no_answer(server: RtuServer, at: int) -> None:
    request = bytearray(framed("11 03 00 6B 00 03"))
    request[at] ^= 0x40
    assert server.receive(bytes(request), 0.0) == b""
    assert server.tick(SILENCE_S) == b""
    assert server.counts.bad_frames == 1
    assert server.receive(framed("11 03 00 6B 00 01"), 0.1) == framed("11 03 02 02 2B")


def test_silence_inside_a_frame_breaks_it(server: RtuServer) -> None:
    request = framed("11 03 00 6B 00 03")
    assert server.receive(request[:4], 0.0) == b""
    assert server.receive(request[4:], SILENCE_S) == b""
    assert server.tick(2 * SILENCE_S) == b""
    assert server.counts.bad_frames == 2


def test_unknown_function_of_unknown_length_ends_with_silence(server: RtuServer) -> None:
    assert server.receive(framed("11 41 01 02 03 04 05 06 07 08 09"), 0.0) == b""
    assert server.tick(SILENCE_S / 2) == b""
    assert server.tick(SILENCE_S) == framed("11 C1 01")


@pytest.mark.parametrize("request_", ["12 03 00 6B 00 03", "12 06 00 01 00 07"])
def test_other_units_are_not_answered(server: RtuServer, request_: str) -> None:
    assert server.receive(framed(request_), 0.0) == b""
    assert (server.counts.foreign, server.counts.requests) == (1, 0)


def test_answer_of_another_unit_on_the_line_is_passed_over(server: RtuServer) -> None:
    server.receive(framed("12 03 06 02 2B 00 00 00 64"), 0.0)
    assert server.receive(framed("11 03 00 6B 00 01"), 1.0) == framed("11 03 02 02 2B")


def test_broadcast_is_obeyed_and_not_answered(server: RtuServer) -> None:
    assert server.receive(framed("00 06 00 01 00 07"), 0.0) == b""
    assert server.receive(framed("11 03 00 01 00 01"), 0.0) == framed("11 03 02 00 07")


def test_hanging_up_forgets_half_a_frame(server: RtuServer) -> None:
    request = framed("11 03 00 6B 00 01")
    server.receive(request[:5], 0.0)
    server.hang_up()
    assert server.receive(request, 0.001) == framed("11 03 02 02 2B")


def test_babble_is_one_bad_frame_and_takes_no_memory(server: RtuServer) -> None:
    for n in range(1000):
        assert server.receive(b"\x11\x41" * 100, 0.001 * n) == b""
    assert len(server._buffer) <= 257
    assert server.tick(2.0) == b""
    assert server.counts.bad_frames == 1
    assert server.receive(framed("11 03 00 6B 00 01"), 3.0) == framed("11 03 02 02 2B")


@given(st.lists(st.tuples(st.binary(max_size=300), st.floats(0, 0.02)), max_size=10))
def test_any_bytes_leave_it_able_to_answer(pieces: list[tuple[bytes, float]]) -> None:
    server = RtuServer(0x11, Registers())
    time_s = 0.0
    for data, pause_s in pieces:
        time_s += pause_s
        server.receive(data, time_s)
        server.tick(time_s)
    answer = server.receive(framed("11 03 00 00 00 01"), time_s + 1)
    assert answer == framed("11 03 02 00 00")


@given(st.integers(0, 255), st.binary(max_size=12))
def test_any_intact_request_gets_an_intact_answer(function: int, body: bytes) -> None:
    server = RtuServer(0x11, Registers())
    answer = server.receive(framed(bytes([0x11, function]).hex() + body.hex()), 0.0)
    answer += server.tick(1.0)
    assert answer[0] == 0x11
    assert answer[1] & 0x7F == function & 0x7F
    assert crc16(answer) == 0
