"""CiA 402 commands of another controller, heard and recorded; the other controller is the
``canopen`` package's own client, so that the bytes are not ours."""

from __future__ import annotations

import canopen
import pytest

from drivers.can_link import CanLink
from drivers.canopen.listener import CanopenListener, ListenerOptions
from drivers.driver import DeviceSpec
from recordings.events import Fault, Mode, ModeCommand, ModeReport
from recordings.faults import FaultKind

DICTIONARY = {
    (0x1000, 0): 0x00020192,
    (0x6040, 0): 0,
    (0x6041, 0): 0x0250,
    (0x6060, 0): 0,
    (0x6071, 0): 0,
    (0x607A, 0): 0,
}


@pytest.fixture
def listen(can_port, clock, bus):
    links = []

    def listen(connect=bus.connect, **options) -> CanLink:
        valid = ListenerOptions.model_validate({"node_id": 17, **options})
        device = CanopenListener(
            DeviceSpec("drive1", "canopen-listener", "bus", "joint1", (), valid)
        )
        port = can_port.model_copy(update={"listen_only": True})
        link = CanLink(port, [device], clock, **({} if connect is None else {"connect": connect}))
        links.append(link)
        link.open()
        link.start(100.0)
        return link

    yield listen
    for link in links:
        link.stop()
        link.close()


def commands(events) -> list[tuple[Mode, int | None]]:
    return [(e.mode, e.target_raw) for e in events if isinstance(e, ModeCommand)]


def test_pdos_of_another_controller(listen, bus):
    link = listen()
    for cob_id, data in (
        (0x211, "06 00 01"),  # shutdown, profile position
        (0x211, "07 00 01"),
        (0x211, "0F 00 01"),  # enabled; holds where it is
        (0x311, "0F 00 D2 04 00 00"),  # a target, not yet taken
        (0x311, "1F 00 D2 04 00 00"),  # rising edge of the set-point bit
        (0x311, "1F 00 D2 04 00 00"),
        (0x211, "0F 00 04"),  # profile torque at 0: free
        (0x411, "0F 00 EC FF"),
        (0x411, "00 00 00 00"),
    ):
        bus.push(cob_id, bytes.fromhex(data))
    assert commands(link.pump(0.0)) == [
        (Mode.OFF, None),
        (Mode.POSITION, None),
        (Mode.POSITION, 1234),
        (Mode.FREE, None),
        (Mode.TORQUE, -20),
        (Mode.OFF, None),
    ]
    assert bus.sent == []


def test_what_the_drive_answers_is_reported(listen, bus):
    link = listen()
    bus.push(0x191, bytes.fromhex("50 02 00"))
    bus.push(0x191, bytes.fromhex("50 02 00"))
    bus.push(0x191, bytes.fromhex("37 02 01"))
    bus.push(0x091, bytes.fromhex("11 86 01 00 00 00 00 00"))
    bus.push(0x191, bytes.fromhex("08 02 01 11 86"))
    reports = [e for e in link.pump(0.0) if isinstance(e, ModeReport)]
    assert [(r.mode, r.error_code) for r in reports] == [
        (Mode.OFF, 0),
        (Mode.POSITION, 0),
        (Mode.FAULT, 0x8611),
    ]


def test_a_mode_that_was_set_before_is_taken_from_the_drive(listen, bus):
    link = listen()
    bus.push(0x191, bytes.fromhex("37 02 04"))
    bus.push(0x411, bytes.fromhex("0F 00 0A 00"))
    assert commands(link.pump(0.0)) == [(Mode.TORQUE, 10)]


def test_other_mappings_and_short_frames(listen, bus):
    link = listen(rpdo={"4": ["pad8", "position", "control"]})
    bus.push(0x511, bytes.fromhex("AA 40 E2 01 00 1F 00"))
    bus.push(0x511, b"\1\2")
    events = link.pump(0.0)
    assert commands(events) == [(Mode.UNKNOWN, None)]
    assert [e.kind for e in events if isinstance(e, Fault)] == [FaultKind.MALFORMED]


@pytest.mark.parametrize(
    ("rpdo", "words"),
    [
        ({"5": ["control"]}, "expected 1 to 4"),
        ({"1": ["speed"]}, "names 'speed'"),
        ({"1": ["position", "pad32", "mode"]}, "longer than the 8 bytes"),
    ],
)
def test_wrong_mappings(rpdo, words):
    with pytest.raises(ValueError, match=words):
        ListenerOptions.model_validate({"node_id": 1, "rpdo": rpdo})


def test_sdo_writes_of_the_canopen_package(listen, slaves, can_port, pump_until):
    slave = slaves(17, DICTIONARY)
    link = listen(connect=None)
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.02
    network.connect(interface="virtual", channel=can_port.channel)
    try:
        node = canopen.RemoteNode(17, slave.node.object_dictionary)
        network.add_node(node)
        node.sdo[0x6060].raw = 1
        for word in (0x06, 0x07, 0x0F):
            node.sdo[0x6040].raw = word
        node.sdo[0x607A].raw = 4711
        node.sdo[0x6040].raw = 0x1F
    finally:
        network.disconnect()
    assert commands(pump_until(link, ModeCommand, 3)) == [
        (Mode.OFF, None),
        (Mode.POSITION, None),
        (Mode.POSITION, 4711),
    ]
