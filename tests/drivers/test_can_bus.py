"""A python-can bus that garbles, dies, is busy or is not there."""

from __future__ import annotations

import can
import can.interfaces.virtual
import pytest

from drivers import can_bus
from drivers.can_bus import EXTENDED, CanBus, connect
from drivers.errors import BadCommand, LinkBroken, LinkClosed, OptionError, PortBusy, PortNotFound
from recordings.rig import CanPort

PORT = CanPort(kind="can", name="bus", interface="virtual", channel="unused")


class ScriptedBus:
    """Gives what it was told to, raises what it was told to."""

    def __init__(self, *script: can.Message | Exception | None) -> None:
        self.script = list(script)
        self.closed = False

    def recv(self, timeout=None):
        item = self.script.pop(0) if self.script else None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, msg, timeout=None):
        self.recv()

    def shutdown(self):
        self.closed = True


def scripted(clock, *script) -> CanBus:
    bus = CanBus(PORT, clock, lambda _port: ScriptedBus(*script))
    bus.open()
    return bus


def message(**fields) -> can.Message:
    return can.Message(
        **{"arbitration_id": 0x181, "data": b"\1\2\3\4", "is_extended_id": False, **fields}
    )


def test_a_frame_is_stamped_with_our_time_not_the_adapters(clock):
    bus = scripted(clock, message(timestamp=12.5))
    frame = bus.receive(0.0)
    assert (frame.identifier, frame.data, frame.time_ns) == (0x181, b"\1\2\3\4", clock.now_ns())


@pytest.mark.parametrize(
    "garbled",
    [
        ValueError("non-hexadecimal number found"),
        UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
        IndexError("string index out of range"),
        message(dlc=8, data=b"\xaa\xbb"),
    ],
)
def test_garbled_frames_are_counted_and_passed_over(clock, garbled):
    bus = scripted(clock, garbled, message())
    assert bus.receive(0.0) is None
    assert bus.malformed == 1
    assert bus.receive(0.0) is not None


def test_error_frames_are_counted_and_others_passed_over(clock):
    bus = scripted(
        clock,
        message(is_error_frame=True),
        message(is_remote_frame=True, data=b""),
        message(is_fd=True),
        None,
    )
    assert [bus.receive(0.0) for _ in range(4)] == [None] * 4
    assert (bus.error_frames, bus.malformed) == (1, 0)


def test_an_identifier_of_29_bits_is_marked(clock):
    frame = scripted(clock, message(arbitration_id=0x181, is_extended_id=True)).receive(0.0)
    assert frame.identifier == 0x181 | EXTENDED


def test_the_adapters_time_is_device_time_where_the_rig_says_so(clock):
    port = PORT.model_copy(update={"adapter_time": True})
    for used, expected in ((port, 12_500_000_000), (PORT, None)):
        bus = CanBus(used, clock, lambda _port: ScriptedBus(message(timestamp=12.5)))
        bus.open()
        assert bus.receive(0.0).device_time_ns == expected


def test_nothing_is_sent_on_a_port_that_listens(clock):
    sent = []
    bus = CanBus(PORT.model_copy(update={"listen_only": True}), clock, lambda _port: sent)
    bus.open()
    with pytest.raises(BadCommand, match="listens only"):
        bus.send(0x80, b"")
    assert sent == []


def test_what_a_bus_counts_as_malformed_outlives_it(clock):
    made = []

    def connect(_port) -> ScriptedBus:
        made.append(ScriptedBus())
        return made[-1]

    bus = CanBus(PORT, clock, connect)
    bus.open()
    made[0].malformed = 3
    bus.close()
    bus.open()
    made[1].malformed = 1
    assert bus.malformed == 4
    bus.close()


@pytest.mark.parametrize(
    "error", [can.CanOperationError("gone"), OSError(5, "I/O error"), RuntimeError("odd")]
)
def test_whatever_a_dead_bus_raises_is_link_broken(clock, error):
    with pytest.raises(LinkBroken, match="port 'bus'"):
        scripted(clock, error).receive(0.0)
    with pytest.raises(LinkBroken, match="port 'bus'"):
        scripted(clock, error).send(0x80, b"")


def test_a_closed_bus_says_that_we_closed_it(clock):
    bus = scripted(clock)
    bus.close()
    bus.close()
    with pytest.raises(LinkClosed):
        bus.receive(0.0)
    with pytest.raises(LinkClosed):
        bus.send(0x80, b"")


def test_a_bus_that_cannot_say_goodbye_is_let_go_all_the_same(clock):
    class Dead(ScriptedBus):
        def shutdown(self):
            raise can.CanOperationError("Could not write to serial device")

    bus = CanBus(PORT, clock, lambda _port: Dead())
    bus.open()
    bus.close()
    with pytest.raises(LinkClosed):
        bus.receive(0.0)


def slcan(path: str) -> CanPort:
    return CanPort(kind="can", name="arm-can", interface="slcan", channel=path)


def test_an_slcan_adapter_that_is_not_there(clock, tmp_path):
    path = str(tmp_path / "nothing")
    with pytest.raises(PortNotFound, match=path):
        CanBus(slcan(path), clock).open()


def test_an_slcan_adapter_is_held_against_a_second_user(clock, line):
    first, second = CanBus(slcan(line.path), clock), CanBus(slcan(line.path), clock)
    first.open()
    line.read_until(b"O\r")
    with pytest.raises(PortBusy, match="in use"):
        second.open()
    # The second user has sent nothing: even a "C" would have closed the first one's channel.
    first.send(0x123, b"\xff")
    assert line.read_until(b"FF\r") == b"t1231FF\r"
    first.close()
    second.open()
    second.close()


def test_an_slcan_line_with_noise(clock, line):
    bus = CanBus(slcan(line.path), clock)
    bus.open()
    line.write(b"t1812ZZ00\rt1238AABB\rt12\r\a\rz\r\xff\xfe\r")
    frames = [frame for _ in range(6) if (frame := bus.receive(0.05)) is not None]
    line.write(b"t18141122AABB\r")
    frames.append(bus.receive(1.0))
    bus.close()
    assert [(f.identifier, f.data) for f in frames] == [(0x181, bytes.fromhex("1122AABB"))]
    assert bus.malformed == 4


def test_an_unplugged_slcan_adapter_is_link_broken_and_leaves_nothing_open(clock, line):
    bus = CanBus(slcan(line.path), clock)
    bus.open()
    line.unplug()
    with pytest.raises(LinkBroken):
        bus.receive(0.1)
    bus.close()
    with pytest.raises(LinkClosed):
        bus.receive(0.0)


@pytest.mark.parametrize(
    ("path", "given", "used"),
    [
        ("pty", {}, 0.0),
        ("pty", {"sleep_after_open": 0.5}, 0.5),
        ("socket://127.0.0.1:7", {}, 0.0),
        ("/dev/ttyUSB0", {}, None),
        ("/dev/ttyUSB0", {"sleep_after_open": 0.1}, 0.1),
    ],
)
def test_time_is_given_to_a_board_where_there_may_be_one(monkeypatch, line, path, given, used):
    asked = []
    monkeypatch.setattr(
        can_bus, "SlcanBus", lambda _path, _bitrate, **options: asked.append(options)
    )
    port = slcan(line.path if path == "pty" else path).model_copy(update={"options": given})
    connect(port)
    assert asked[0].get("sleep_after_open") == used


def test_any_other_interface_is_python_cans_own(can_port):
    bus = connect(can_port)
    assert isinstance(bus, can.interfaces.virtual.VirtualBus)
    bus.shutdown()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bitrate": 123_456}, "'bitrate' is 123456"),
        ({"options": {"speed": 1}}, "unknown key 'speed'"),
        ({"options": {"tty_baudrate": "fast"}}, "'tty_baudrate' is 'fast'"),
        ({"interface": "socketcand", "options": {}}, "missing key 'host'"),
        ({"interface": "socketcand", "options": {"host": "a", "port": 0}}, "'port' is 0"),
        ({"interface": "slcam"}, "'interface' is 'slcam'"),
    ],
)
def test_wrong_port_options(clock, change, words):
    with pytest.raises(OptionError, match=words):
        CanBus(slcan("/dev/ttyUSB0").model_copy(update=change), clock)
