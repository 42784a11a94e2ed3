"""slcan lines to frames and back: bytes pinned from Lawicel's manual, and a flood without a loss."""

from __future__ import annotations

import threading

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.slcan import Garbled, LineBuffer, SlcanBus, decode, encode

# The examples of the CAN232 manual: "t10021133", "T0000010021133", "r1002", "R000001002".
MANUAL = [
    (b"t10021133", {"arbitration_id": 0x100, "data": b"\x11\x33", "is_extended_id": False}),
    (b"T0000010021133", {"arbitration_id": 0x100, "data": b"\x11\x33", "is_extended_id": True}),
    (
        b"r1002",
        {"arbitration_id": 0x100, "dlc": 2, "is_remote_frame": True, "is_extended_id": False},
    ),
    (
        b"R000001002",
        {"arbitration_id": 0x100, "dlc": 2, "is_remote_frame": True, "is_extended_id": True},
    ),
]


@pytest.mark.parametrize(("line", "fields"), MANUAL)
def test_frames_of_the_manual(line, fields):
    message = can.Message(**fields)
    assert encode(message) == line + b"\r"
    decoded = decode(line)
    assert decoded.equals(message, timestamp_delta=None)


def test_the_adapters_time_stamp_is_passed_over():
    assert bytes(decode(b"t1002113304D2").data) == b"\x11\x33"


@pytest.mark.parametrize("line", [b"", b"z", b"Z", b"V1013", b"NA123", b"F00"])
def test_replies_to_commands_are_no_frames(line):
    assert decode(line) is None


@pytest.mark.parametrize(
    "line",
    [
        b"t1238AABB",
        b"t1812ZZ00",
        b"t12",
        b"t",
        b"t1819" + b"00" * 9,
        b"t181",
        b"\xff\xfe",
        b"hello",
        b"t80021133",
        b"t100211334D",
        b"T1002",
    ],
)
def test_garbled_lines_are_told_apart(line):
    with pytest.raises(Garbled, match="the adapter sent"):
        decode(line)


@pytest.mark.parametrize("size", range(1, 12))
def test_lines_are_whole_however_they_arrive(size):
    stream = b"t10021133\r\a\rz\rt1000\rt1"
    buffer, lines = LineBuffer(), []
    for start in range(0, len(stream), size):
        lines += buffer.feed(stream[start : start + size])
    assert [line for line in lines if line] == [b"t10021133", b"z", b"t1000"]
    assert buffer.feed(b"230\r") == [b"t1230"]


def test_babble_without_an_end_does_not_pile_up():
    buffer = LineBuffer()
    cut = [line for _ in range(100) for line in buffer.feed(b"x" * 20)]
    assert len(cut) > 40
    assert buffer.feed(b"\r")[-1:] != []


@settings(deadline=None, derandomize=True)
@given(identifier=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_any_frame_survives_both_ways(identifier, data):
    message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
    assert decode(encode(message)[:-1]).equals(message, timestamp_delta=None)


def test_an_adapter_is_set_up_and_closed(line):
    bus = SlcanBus(line.path, 500_000, sleep_after_open=0.0)
    assert line.read_until(b"O\r") == b"C\rS6\rO\r"
    bus.shutdown()
    assert line.read_until(b"C\r") == b"C\r"


def test_listen_only(line):
    bus = SlcanBus(f"{line.path}@57600", sleep_after_open=0.0, listen_only=True)
    assert line.read_until(b"L\r").endswith(b"L\r")
    bus.shutdown()


def test_a_bit_rate_that_no_adapter_knows(line):
    with pytest.raises(ValueError, match="1000000"):
        SlcanBus(line.path, 123, sleep_after_open=0.0)


def test_a_flood_is_taken_without_a_loss(line):
    count = 20_000
    bus = SlcanBus(line.path, sleep_after_open=0.0)

    def flood() -> None:
        for number in range(0, count, 20):
            frames = (f"t1234{n:08X}\r" for n in range(number, number + 20))
            line.write("".join(frames).encode())

    writer = threading.Thread(target=flood)
    writer.start()
    seen = []
    while len(seen) < count and (message := bus.recv(2.0)) is not None:
        seen.append(int.from_bytes(message.data, "big"))
    writer.join()
    bus.shutdown()
    assert seen == list(range(count))
