"""The adapter end of slcan, against the examples of Lawicel's CAN232 manual."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_devices.can_bus import Frame
from sim_devices.slcan import BELL, Channel, SlcanAdapter


def opened() -> SlcanAdapter:
    adapter = SlcanAdapter()
    assert adapter.receive(b"S8\rO\r") == [b"\r", b"\r"]
    return adapter


# Examples of the manual's command chapter, with their frames.
FRAMES = [
    (b"t10021133\r", b"z\r", Frame(0x100, bytes.fromhex("1133"))),
    (b"T0000010021133\r", b"Z\r", Frame(0x100, bytes.fromhex("1133"), extended=True)),
    (b"r1002\r", b"z\r", Frame(0x100, remote_length=2)),
    (b"R000001002\r", b"Z\r", Frame(0x100, extended=True, remote_length=2)),
    (b"t0000\r", b"z\r", Frame(0)),
    (b"t7FF81122334455667788\r", b"z\r", Frame(0x7FF, bytes.fromhex("1122334455667788"))),
    (b"T1FFFFFFF1aB\r", b"Z\r", Frame(0x1FFFFFFF, b"\xab", extended=True)),
]


@pytest.mark.parametrize(("line", "reply", "frame"), FRAMES)
def test_frame_from_the_host(line: bytes, reply: bytes, frame: Frame) -> None:
    assert opened().receive(line) == [reply, frame]


@pytest.mark.parametrize(("line", "reply", "frame"), FRAMES)
def test_frame_from_the_host_byte_by_byte(line: bytes, reply: bytes, frame: Frame) -> None:
    adapter = opened()
    pieces = [adapter.receive(bytes([byte])) for byte in line]
    assert not any(pieces[:-1])
    assert pieces[-1] == [reply, frame]


@pytest.mark.parametrize(("line", "reply", "frame"), FRAMES)
def test_frame_from_the_host_with_bytes_behind_it(line: bytes, reply: bytes, frame: Frame) -> None:
    adapter = opened()
    assert adapter.receive(line + b"t1001") == [reply, frame]
    assert adapter.receive(b"AA\r") == [b"z\r", Frame(0x100, b"\xaa")]


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        (Frame(0x100, bytes.fromhex("1133")), b"t10021133\r"),
        (Frame(0x100, bytes.fromhex("1133"), extended=True), b"T0000010021133\r"),
        (Frame(0x100, remote_length=2), b"r1002\r"),
        (Frame(0x100, extended=True, remote_length=2), b"R000001002\r"),
        (Frame(0x181, bytes.fromhex("400D030001002710")), b"t1818400D030001002710\r"),
    ],
)
def test_frame_to_the_host(frame: Frame, line: bytes) -> None:
    assert opened().encode(frame, 0.0) == line


def test_time_stamps_are_milliseconds_of_a_minute() -> None:
    adapter = SlcanAdapter()
    assert adapter.receive(b"Z1\rO\r") == [b"\r", b"\r"]
    # The manual: 0 to 60,000 ms, 0x0000 to 0xEA5F.
    assert adapter.encode(Frame(0x100), 59.9995) == b"t1000EA5F\r"
    assert adapter.encode(Frame(0x100), 60.0005) == b"t10000000\r"
    assert adapter.receive(b"Z0\r") == [BELL]
    assert adapter.receive(b"C\rZ0\rO\r") == [b"\r", b"\r", b"\r"]
    assert adapter.encode(Frame(0x100), 1.0) == b"t1000\r"


@pytest.mark.parametrize(
    ("line", "closed", "open_"),
    [
        (b"O", b"\r", BELL),
        (b"L", b"\r", BELL),
        (b"C", BELL, b"\r"),
        (b"S6", b"\r", BELL),
        (b"s031C", b"\r", BELL),
        (b"M00000000", b"\r", BELL),
        (b"mFFFFFFFF", b"\r", BELL),
        (b"Z1", b"\r", BELL),
        (b"F", BELL, b"F00\r"),
        (b"V", b"V1013\r", b"V1013\r"),
        (b"N", b"NLC01\r", b"NLC01\r"),
        (b"", b"\r", b"\r"),
        (b"t1000", BELL, None),
    ],
)
def test_state_of_the_channel_decides(line: bytes, closed: bytes, open_: bytes | None) -> None:
    adapter = SlcanAdapter()
    assert adapter.receive(line + b"\r") == [closed]
    if open_ is not None:
        assert opened().receive(line + b"\r") == [open_]
    assert adapter.malformed == 0


def test_closed_channel_is_deaf_and_dumb() -> None:
    adapter = opened()
    adapter.receive(b"C\r")
    assert adapter.encode(Frame(0x100), 0.0) == b""
    assert adapter.receive(b"t1000\r") == [BELL]


def test_listening_channel_hears_and_does_not_speak() -> None:
    adapter = SlcanAdapter()
    adapter.receive(b"L\r")
    assert adapter.encode(Frame(0x100), 0.0) == b"t1000\r"
    assert adapter.receive(b"t1000\r") == [BELL]


MALFORMED = [
    b"t1238AABB",  # fewer bytes than announced
    b"t12319AABB",  # more
    b"t1239112233445566778899",  # longer than a frame can be
    b"t8000",  # 12 bits
    b"T200000000",  # 30 bits
    b"t10Z0",
    b"t1001A",
    b"t1001GG",
    b"r100211",
    b"t",
    b"S",
    b"S10",
    b"s03",
    b"Z2",
    b"Vx",
    b"?",
    b"\xff\xfe",
    b"\nO",
    b"t1001 1",
    b"x" * 200,
]


@pytest.mark.parametrize("line", MALFORMED)
def test_malformed_is_answered_bell_and_counted(line: bytes) -> None:
    adapter = opened()
    assert adapter.receive(line + b"\r") == [BELL]
    assert adapter.malformed == 1
    assert adapter.receive(b"t1000\r") == [b"z\r", Frame(0x100)]


def test_overlong_line_in_pieces_is_one_malformed_command() -> None:
    adapter = opened()
    for _ in range(100):
        assert adapter.receive(b"t" * 100) == []
    assert adapter.receive(b"\rV\r") == [BELL, b"V1013\r"]
    assert adapter.malformed == 1


def test_overrun_shows_once_in_the_status_flags() -> None:
    adapter = opened()
    adapter.note_overrun()
    assert adapter.receive(b"F\rF\r") == [b"F08\r", b"F00\r"]


def test_hanging_up_closes_the_channel_and_forgets_half_a_command() -> None:
    adapter = opened()
    adapter.receive(b"t10")
    adapter.hang_up()
    assert adapter.channel is Channel.CLOSED
    assert adapter.receive(b"O\r") == [b"\r"]


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_any_bytes_get_one_reply_a_line(pieces: list[bytes]) -> None:
    adapter = SlcanAdapter()
    replies = [item for piece in pieces for item in adapter.receive(piece)]
    assert sum(isinstance(item, bytes) for item in replies) == b"".join(pieces).count(b"\r")


@given(st.binary(max_size=100), st.data())
def test_pieces_do_not_matter(line: bytes, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(line)))
    whole, split = opened(), opened()
    halves = [*split.receive(line[:cut]), *split.receive(line[cut:])]
    assert halves == list(whole.receive(line))


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.sampled_from([0.0, 1.5]), st.booleans())
def test_what_one_adapter_shows_another_sends(
    identifier: int, data: bytes, time_s: float, extended: bool
) -> None:
    frame = Frame(identifier, data, extended)
    shown = opened().encode(frame, time_s)
    assert opened().receive(shown)[1] == frame
