"""Where faults take hold: slots, plugs, damaged lines, stuck channels, babblers."""

from __future__ import annotations

import os
import random
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from recordings.rig import Device
from sim_devices.can_bus import Frame
from sim_devices.errors import PortTaken
from sim_devices.faults.babble import Babbler, BabblingDevice, BabblingNode
from sim_devices.faults.plug import DamagedLine, Plug
from sim_devices.faults.slots import BOOT_S, CanSlot, Disturbance, LineSlot, flip_a_bit, undamaged
from sim_devices.faults.stuck import StuckPlant
from sim_devices.modbus import crc16
from sim_devices.pty_port import PtyPort

DEVICE = Device(name="thing", driver="any", port="port", options={"unit_id": 7})


@dataclass
class Echo:
    """A serial device that answers with what it got, its number, and its own time."""

    number: int
    hung_up: int = 0

    def receive(self, data: bytes, time_s: float) -> bytes:
        return bytes([self.number, round(10 * time_s)]) + data

    def tick(self, time_s: float) -> bytes:
        return b""

    def hang_up(self) -> None:
        self.hung_up += 1


@dataclass
class Node:
    """A node that says on each tick how many ticks it has lived."""

    ticks: int = 0
    heard: list[Frame] = field(default_factory=list)

    def receive(self, frame: Frame, time_s: float) -> list[Frame]:
        self.heard.append(frame)
        return [Frame(0x100, bytes([len(self.heard)]))]

    def tick(self, time_s: float) -> list[Frame]:
        self.ticks += 1
        return [Frame(0x181, bytes([self.ticks % 256]))]


@pytest.fixture
def line_slot() -> LineSlot:
    return LineSlot(DEVICE, lambda d: Echo(d.options["unit_id"]), lambda: None, seed=1)


@pytest.fixture
def can_slot() -> CanSlot:
    return CanSlot(DEVICE, lambda d: Node(), lambda: None, undamaged, seed=1)


def test_without_a_fault_a_slot_is_its_device(line_slot, can_slot) -> None:
    assert line_slot.receive(b"ab", 0.3) == b"\x07\x03ab"
    assert [frame.data for n in range(3) for frame in can_slot.tick(n)] == [b"\1", b"\2", b"\3"]


def test_a_restart_takes_the_power_and_begins_anew(line_slot, can_slot) -> None:
    line_slot.receive(b"a", 5.0)
    line_slot.restart(5.0)
    assert line_slot.receive(b"a", 5.0 + BOOT_S / 2) == b""
    assert line_slot.receive(b"a", 5.0 + BOOT_S + 0.1) == b"\x07\x01a"
    can_slot.tick(0.0)
    can_slot.restart(1.0)
    assert can_slot.tick(1.1) == []
    assert [frame.data for frame in can_slot.tick(1.3)] == [b"\1"]


def test_a_drive_without_power_lets_go_of_its_joint() -> None:
    let_go = []
    slot = CanSlot(DEVICE, lambda d: Node(), lambda: let_go.append(1), undamaged, seed=1)
    slot.restart(1.0)
    assert let_go == [1]


def test_another_number_comes_and_goes_with_a_restart(line_slot) -> None:
    line_slot.renumber(9, 1.0)
    assert line_slot.receive(b"a", 1.1) == b""
    assert line_slot.receive(b"a", 2.0)[0] == 9
    line_slot.renumber(None, 3.0)
    assert line_slot.receive(b"a", 4.0)[0] == 7


def test_a_device_without_a_number_cannot_have_another() -> None:
    bare = DEVICE.model_copy(update={"options": {}})
    slot = LineSlot(bare, lambda d: Echo(1), lambda: None, seed=1)
    slot.renumber(9, 1.0)
    assert slot.receive(b"a", 1.1) == b"\x01\x0ba"


def test_doubled_nodes_both_talk_and_doubled_units_collide(can_slot, line_slot) -> None:
    can_slot.tick(0.0)
    can_slot.double(True, 1.0)
    assert [frame.data for frame in can_slot.tick(1.0)] == [b"\2", b"\1"]
    can_slot.double(False, 2.0)
    assert [frame.data for frame in can_slot.tick(2.0)] == [b"\3"]
    line_slot.double(True, 1.0)
    assert line_slot.receive(b"\x0f", 2.3) == bytes([7, 23 & 13, 0x0F])


def test_a_silent_device_still_hears_and_a_detached_one_does_not(can_slot) -> None:
    node = can_slot._units[0][0]
    can_slot.disturbance = Disturbance(silent=True)
    assert can_slot.receive(Frame(0x80), 0.0) == []
    can_slot.disturbance = Disturbance(detached=True)
    assert can_slot.receive(Frame(0x80), 0.0) == []
    assert can_slot.tick(0.0) == []
    assert (len(node.heard), node.ticks) == (1, 1)


def test_messages_are_lost_at_their_rate_and_counted(can_slot) -> None:
    can_slot.disturbance = Disturbance(drop=0.25)
    came = sum(len(can_slot.tick(n * 0.01)) for n in range(1000))
    assert came + can_slot.dropped == 1000
    assert 200 < can_slot.dropped < 300


def test_messages_come_later_and_in_order(line_slot) -> None:
    line_slot.disturbance = Disturbance(delay_s=0.1)
    assert line_slot.receive(b"a", 1.00) == b""
    assert line_slot.receive(b"b", 1.05) == b""
    assert line_slot.tick(1.09) == b""
    assert line_slot.tick(1.101) == b"\x07\x0aa"
    assert line_slot.tick(1.151) == b"\x07\x0ab"


def test_what_is_under_way_is_lost_when_the_host_goes(line_slot) -> None:
    line_slot.disturbance = Disturbance(delay_s=0.1)
    line_slot.receive(b"a", 1.0)
    line_slot.hang_up()
    assert line_slot.tick(2.0) == b""


def test_a_foreign_reply_is_whole_and_comes_first() -> None:
    class Slave(Echo):
        def receive(self, data: bytes, time_s: float) -> bytes:
            return data + crc16(data).to_bytes(2, "little")

    slot = LineSlot(DEVICE, lambda d: Slave(7), lambda: None, seed=1)
    slot.disturbance = Disturbance(foreign=True)
    answer = slot.receive(b"\x07\x04\x02\x00\x05", 0.0)
    assert answer[:5] == b"\x08\x04\x02\x00\x05"
    assert crc16(answer[:7]) == 0
    assert answer[7:12] == b"\x07\x04\x02\x00\x05"


def test_a_damaged_message_differs_in_one_bit() -> None:
    rng = random.Random(2)
    for _ in range(100):
        data = rng.randbytes(9)
        damaged = flip_a_bit(data, rng)
        assert (int.from_bytes(data, "big") ^ int.from_bytes(damaged, "big")).bit_count() == 1


class Counts:
    """Nature that counts up at every look."""

    def __init__(self) -> None:
        self.now = 0

    def advance(self, time_s: float) -> None: ...

    def sense(self, channel: str) -> int:
        self.now += 1
        return self.now

    def command(self, joint: str, mode: str, target_raw: int) -> None: ...

    def drive_fault(self, joint: str) -> int:
        return 0


def test_a_held_channel_keeps_its_count_and_others_do_not() -> None:
    plant = StuckPlant(Counts())
    assert plant.sense("q1") == 1
    plant.hold({"q1"})
    assert [plant.sense("q1"), plant.sense("q2"), plant.sense("q1")] == [2, 3, 2]
    plant.hold({"q1", "q2"})
    assert [plant.sense("q1"), plant.sense("q2"), plant.sense("q2")] == [2, 4, 4]
    plant.hold(())
    assert plant.sense("q1") == 5


def test_a_babbler_speaks_at_its_rate_and_does_not_make_up_for_a_pause() -> None:
    babbler = Babbler(seed=1)
    node = BabblingNode(babbler)
    assert node.tick(0.0) == []
    babbler.rate_hz = 1000.0
    said = [frame for tick in range(201) for frame in node.tick(1.0 + tick * 0.005)]
    assert len(said) == pytest.approx(1000, abs=1)
    assert len(node.tick(60.0)) <= 101
    assert node.receive(Frame(0x80), 61.0) == ()
    babbler.rate_hz = 0.0
    assert node.tick(62.0) == []
    device = BabblingDevice(babbler)
    babbler.rate_hz = 500.0
    device.tick(63.0)
    assert len(device.receive(b"hush", 63.1)) == 50
    device.hang_up()


class Far:
    """The far end of a pty: answers at once."""

    def __init__(self) -> None:
        self.hung_up = 0
        self.ticks = 0

    def receive(self, data: bytes, time_s: float) -> bytes:
        return data.upper()

    def tick(self, time_s: float) -> bytes:
        self.ticks += 1
        return b""

    def hang_up(self) -> None:
        self.hung_up += 1

    def overrun(self) -> None: ...


@pytest.mark.wires
def test_an_unplugged_port_is_gone_for_its_host_and_comes_back(tmp_path: Path) -> None:
    far = Far()
    plug = Plug(PtyPort("port", str(tmp_path / "port"), far))
    plug.open()
    host = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
    try:
        plug.tick(0.0)
        os.write(host, b"abc")
        plug.serve(0.0)
        assert os.read(host, 10) == b"ABC"
        plug.plugged = False
        plug.tick(1.0)
        assert far.hung_up == 1
        assert not os.path.lexists(tmp_path / "port")
        with pytest.raises(OSError, match="Input/output error"):
            os.write(host, b"abc") and os.read(host, 10)
        assert plug.fileno() is None
        plug.serve(1.1)
        plug.tick(1.1)
        assert far.ticks == 3
    finally:
        os.close(host)
    plug.plugged = True
    plug.tick(2.0)
    host = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
    plug.tick(2.1)
    os.write(host, b"x")
    plug.serve(2.2)
    assert os.read(host, 10) == b"X"
    os.close(host)
    plug.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.wires
def test_a_path_that_somebody_took_meanwhile_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "port"
    plug = Plug(PtyPort("port", str(path), Far()))
    path.write_text("mine")
    with pytest.raises(PortTaken):
        plug.open()
    plug.tick(0.0)
    assert path.read_text() == "mine"
    path.unlink()
    plug.tick(0.1)
    assert path.is_char_device()
    plug.close()


def test_a_damaged_line_damages_what_goes_to_the_host_only() -> None:
    far = Far()
    line = DamagedLine(far, seed=1)
    assert line.receive(b"abc", 0.0) == b"ABC"
    line.corrupt = 1.0
    assert line.receive(b"abc", 0.0) != b"ABC"
    assert line.tick(0.0) == b""
    line.hang_up()
    line.overrun()
    assert far.hung_up == 1
