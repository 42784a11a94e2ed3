"""Building virtual devices from a rig: what is built, and what is refused in which words."""

from __future__ import annotations

import pytest

from recordings.rig import Rig, parse_rig, rig_text
from sim_devices.bench import build_ports
from sim_devices.bus_port import BusPort
from sim_devices.can_bus import Frame
from sim_devices.errors import DeviceNotSimulated
from sim_devices.faults.wiring import Wiring
from sim_devices.kinds import can_bus, serial_line
from sim_devices.modbus import crc16
from sim_devices.pty_port import PtyPort


def edited(rig: str, *edits: tuple[str, str]) -> Rig:
    text = rig_text(rig)[0]
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return parse_rig(text)


def test_bus_of_the_arm(arm: Rig, plant) -> None:
    bus = can_bus(arm, arm.ports[0], plant)
    boots = [frame.identifier - 0x700 for frame in bus.tick(0.0)]
    assert boots == [1, 2, 3, 4, 5, 17, 18, 19, 20, 21, 22, 23]
    plant.counts = {f"q{n}": 100 * n for n in range(1, 8)}
    bus.receive(Frame(0x000, b"\x01\x00"), 0.0)
    sent = {frame.identifier: frame.data for frame in bus.receive(Frame(0x080), 0.0)}
    assert len(sent) == 12
    assert int.from_bytes(sent[0x183][:4], "little") == 300


def test_line_of_the_shoulder(plant) -> None:
    rig = edited("shoulder")
    plant.counts = {"d1": 11, "d2": 12, "d3": 13, "d4": 14}
    request = bytes.fromhex("01 04 00 00 00 05")
    request += crc16(request).to_bytes(2, "little")
    answer = serial_line(rig, rig.ports[0], plant).receive(request, 0.0)
    assert answer[:-2] == bytes.fromhex("01 04 0a 0001 000b 000c 000d 000e")


@pytest.mark.parametrize(
    ("rig", "edit", "words"),
    [
        ("arm", ('"canopen-encoder"', '"canopen-laser"'), "there are: canopen-encoder"),
        ("arm", ("{ node_id = 1 }", "{ node_id = 0 }"), "'node_id' of device 'encoder1' is 0"),
        ("arm", ("{ node_id = 1 }", "{ }"), "'node_id' of device 'encoder1' is missing"),
        ("arm", ("{ node_id = 1 }", "{ node_id = 17 }"), "both have node_id = 17"),
        ("arm", ('device = "encoder1"\n', ""), "'encoder1' delivers 0 channels"),
        ("arm", ('joint = "joint1"\n', ""), "'drive1' moves no joint"),
        ("arm", ('joint = "joint1"\n', 'joint = "hinge"\n'), "'hinge', which no channel senses"),
        ("arm", ("signal = 1\n", "signal = 2\n"), "'q7' has the signal 2"),
        ("arm", ("signal = 1\n", ""), "'q7' has the signal None"),
        ("arm", ("counter_register = 0", "counter_register = 3"), "collide"),
        ("arm", ("unit_id = 1", "unit_id = 248"), "expected 1 to 247"),
        ("arm", ("channels = 2", "channels = true"), "'channels'"),
        ("arm", ('"/tmp/loopcal-arm-wrist"', '"rfc2217://localhost:1"'), "appears at a path"),
    ],
)
def test_what_cannot_be_built_is_named(rig, edit, words, plant) -> None:
    with pytest.raises(DeviceNotSimulated, match=words):
        build_ports(edited(rig, edit), Wiring(edited(rig, edit), plant, 0), {})


def test_path_for_an_unknown_port_is_refused(arm: Rig, plant) -> None:
    with pytest.raises(DeviceNotSimulated, match="the rig has: arm-can, arm-wrist"):
        build_ports(arm, Wiring(arm, plant, 0), {"arm": "/nowhere"})


def test_rig_without_ports_is_refused(plant) -> None:
    text = rig_text("shoulder")[0]
    head = text[: text.index("[[port]]")].replace('device = "lvdt-adc"\n', "")
    with pytest.raises(DeviceNotSimulated, match="no ports"):
        build_ports(parse_rig(head), Wiring(parse_rig(head), plant, 0), {})


def test_where_the_ports_are(plant) -> None:
    slcan = edited("arm", ('"/tmp/loopcal-arm-can"', '"/tmp/loopcal-arm-can@115200"'))
    virtual = edited("arm", ('"slcan"', '"virtual"'))
    built = build_ports(slcan, Wiring(slcan, plant, 0), {})
    assert [type(port) for port in built] == [PtyPort, PtyPort]
    assert built[0].address == "/tmp/loopcal-arm-can"
    assert type(build_ports(virtual, Wiring(virtual, plant, 0), {})[0]) is BusPort
    moved = build_ports(virtual, Wiring(virtual, plant, 0), {"arm-can": "/tmp/elsewhere"})[0]
    assert (type(moved), moved.address) == (PtyPort, "/tmp/elsewhere")
