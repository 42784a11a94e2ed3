"""slcan lines to frames and back: bytes pinned from Lawicel's manual, and a flood without a loss."""

from __future__ import annotations

import socket
import threading

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.slcan import AdapterClock, Garbled, LineBuffer, SlcanBus, decode, encode
from tests.drivers.patience import PATIENCE_S

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


def test_the_adapters_time_stamp_is_taken():
    message = decode(b"t1002113304D2")
    assert (bytes(message.data), message.stamp_ms) == (b"\x11\x33", 0x04D2)
    assert decode(b"t10021133").stamp_ms is None


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
        b"t10021133EA60",
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
    assert [line for line in lines if line] == [b"t10021133", b"\a", b"z", b"t1000"]
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


def test_the_adapter_is_told_to_stamp_before_it_is_opened(line):
    bus = SlcanBus(line.path, sleep_after_open=0.0, time_stamps=True)
    assert line.read_until(b"O\r").endswith(b"Z1\rO\r")
    bus.shutdown()


def test_adapter_time_goes_on_over_its_wraps_and_pauses():
    clock = AdapterClock()
    first_ns, first_s = clock.read(59_990, 100.0)
    wrapped_ns, wrapped_s = clock.read(10, 100.025)
    assert wrapped_ns - first_ns == 20_000_000
    assert wrapped_s - first_s == pytest.approx(0.020, abs=1e-4)
    paused_ns, _ = clock.read(20, 100.025 + 180.012)  # three turns of the stamp
    assert paused_ns - wrapped_ns == 180_010_000_000


def test_late_frames_are_stamped_with_the_time_of_their_arrival_at_the_adapter():
    clock = AdapterClock()
    clock.read(0, 50.0)
    # A burst that the host reads 30 ms late, all at once.
    burst = [clock.read(ms, 50.040)[1] for ms in (10, 20, 30, 40)]
    assert burst == [pytest.approx(50.0 + ms * 1e-3, abs=1e-4) for ms in (10, 20, 30, 40)]


def test_the_estimate_follows_a_clock_that_drifts():
    clock, host_s = AdapterClock(), 0.0
    error = []
    for second in range(1, 1800):
        host_s = second * (1 + 100e-6)  # the adapter loses 100 us a second against the host
        _, seen_s = clock.read(second * 1000 % 60_000, host_s)
        error.append(abs(seen_s - host_s))
    assert max(error) < 1e-3


def test_malformed_lines_are_counted_and_passed_over(line):
    bus = SlcanBus(line.path, sleep_after_open=0.0)
    line.write(b"t1812ZZ00\rt1812AABB\rgarbage\rt18120011EA60\rt1812CCDD0005\r")
    frames = [bus.recv(PATIENCE_S), bus.recv(PATIENCE_S)]
    assert [bytes(frame.data) for frame in frames] == [b"\xaa\xbb", b"\xcc\xdd"]
    assert [frame.adapter_ns for frame in frames] == [None, 5_000_000]
    assert bus.malformed == 3
    bus.shutdown()


def test_an_adapter_that_goes_away_is_an_error_of_python_can(line):
    bus = SlcanBus(line.path, sleep_after_open=0.0)
    line.unplug()
    with pytest.raises(can.CanOperationError, match="is gone"):
        bus.recv(PATIENCE_S)
    bus.shutdown()


def test_an_adapter_that_is_not_there(tmp_path):
    with pytest.raises(can.CanInitializationError, match="cannot open"):
        SlcanBus(str(tmp_path / "none"), sleep_after_open=0.0)


def test_other_programs_find_it_by_its_name(line):
    with can.Bus(interface="loopcal-slcan", channel=line.path, sleep_after_open=0.0) as bus:
        assert isinstance(bus, SlcanBus)
        line.write(b"t1230\r")
        assert bus.recv(PATIENCE_S).arbitration_id == 0x123


def test_a_listener_of_python_can_gets_every_frame_of_a_block(line):
    seen, done = [], threading.Event()

    def listen(message: can.Message) -> None:
        seen.append(message.arbitration_id)
        if len(seen) == 50:
            done.set()

    bus = SlcanBus(line.path, sleep_after_open=0.0)
    notifier = can.Notifier(bus, [listen], timeout=0.05)
    line.write(b"".join(b"t%03X0\r" % number for number in range(50)))
    assert done.wait(PATIENCE_S)
    notifier.stop()
    bus.shutdown()
    assert seen == list(range(50))


def test_an_adapter_on_a_socket_is_read_in_blocks_too():
    with socket.create_server(("127.0.0.1", 0)) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.getsockname()[1]}", sleep_after_open=0.0)
        peer, _ = server.accept()
        peer.sendall(b"".join(b"t1234%08X\r" % number for number in range(2000)))
        seen = [int.from_bytes(bus.recv(PATIENCE_S).data, "big") for _ in range(2000)]
        assert seen == list(range(2000))
        peer.close()
        with pytest.raises(can.CanOperationError, match="is gone"):
            bus.recv(PATIENCE_S)
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
    while len(seen) < count and (message := bus.recv(PATIENCE_S)) is not None:
        seen.append(int.from_bytes(message.data, "big"))
    writer.join()
    bus.shutdown()
    assert seen == list(range(count))
