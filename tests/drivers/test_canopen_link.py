"""The CANopen link against nodes of the ``canopen`` package."""

from __future__ import annotations

import struct
import threading
from itertools import pairwise

import pytest

from drivers.can_device import Identity
from drivers.can_link import CanLink
from drivers.canopen.encoder import Encoder, EncoderOptions
from drivers.canopen.joint import CanopenJoint, JointOptions
from drivers.driver import DeviceSpec
from drivers.errors import DeviceRefused, DeviceSilent, LinkClosed
from drivers.link import Losses
from recordings.events import Fault, Mode, ModeReport, Reading
from recordings.faults import FaultKind

ENCODER = {(0x1000, 0): 0x00010196, (0x1008, 0): "loopcal virtual encoder", (0x6004, 0): 4711}
DRIVE = {
    (0x1000, 0): 0x00020192,
    (0x1008, 0): "Servo 9",
    (0x1016, 1): 0,
}
HZ = 100.0
STEP_S = 1 / HZ


@pytest.fixture
def encoder(channel):
    def make(node_id: int, **options) -> Encoder:
        valid = EncoderOptions.model_validate({"node_id": node_id, **options})
        name = f"encoder{node_id}"
        return Encoder(
            DeviceSpec(name, "canopen-encoder", "bus", None, (channel(f"q{node_id}"),), valid)
        )

    return make


def joint(node_id: int) -> CanopenJoint:
    options = JointOptions.model_validate({"node_id": node_id})
    return CanopenJoint(
        DeviceSpec(f"drive{node_id}", "canopen-joint", "bus", "joint1", (), options)
    )


@pytest.fixture
def make_link(can_port, clock):
    """Makes and opens links, and closes them."""
    links = []

    def make(*devices, **options) -> CanLink:
        link = CanLink(can_port, devices, clock, **options)
        links.append(link)
        link.open()
        return link

    yield make
    for link in links:
        link.close()


def answering(slave, *, plain: bool = False, drop=()):
    """Let ``slave`` answer each SYNC with a position, except the sample numbers in ``drop``."""
    count = [0]

    def answer() -> None:
        if not slave.started:
            return
        count[0] += 1
        if count[0] not in drop:
            data = struct.pack("<IHH", 1000 + count[0], count[0], 100 * count[0])
            slave.send(0x180 + slave.node_id, data[:4] if plain else data)

    slave.on_sync(answer)


def faults(events: list) -> list[Fault]:
    return [event for event in events if isinstance(event, Fault)]


def test_every_device_is_asked_who_it_is(slaves, make_link, encoder):
    slaves(1, ENCODER)
    slaves(2, {**ENCODER, (0x1008, 0): "Baumer"})
    slaves(17, DRIVE)
    link = make_link(encoder(1), encoder(2), joint(17))
    first, second, drive = link.check()
    assert (first.name, first.driver, first.port) == ("encoder1", "canopen-encoder", "bus")
    assert first.channels == ("q1",)
    assert first.answers
    assert first.identity == "loopcal virtual encoder"
    assert first.virtual
    assert first.problem == ""
    assert (second.identity, second.virtual) == ("Baumer", False)
    assert (drive.identity, drive.channels, drive.problem) == ("Servo 9", (), "")


def test_silent_devices_are_named_and_waited_for_together(slaves, make_link, encoder):
    slaves(1, ENCODER)
    devices = [encoder(n) for n in range(1, 14)]
    together = threading.Barrier(len(devices))
    for device in devices:
        device.identify = _when_all_are_asked(device.identify, together)
    statuses = make_link(*devices).check()
    assert [status.answers for status in statuses] == [True] + 12 * [False]
    assert "node 13 gave no valid answer" in statuses[12].problem
    assert statuses[12].channels == ("q13",)


def _when_all_are_asked(identify, together: threading.Barrier):
    """``identify``, which waits for all others to be asked; it breaks where they wait for it."""

    def wait() -> Identity:
        together.wait(60.0)
        return identify()

    return wait


def test_a_device_of_another_kind_is_a_problem(slaves, make_link, encoder):
    slaves(1, DRIVE)
    (status,) = make_link(encoder(1)).check()
    assert status.answers
    assert "CiA 402, expected CiA 406" in status.problem


def test_a_device_without_a_name_gives_vendor_and_product(slaves, make_link, encoder):
    slaves(1, {(0x1000, 0): 0x00010196, (0x1018, 1): 0xBEEF, (0x1018, 2): 7})
    (status,) = make_link(encoder(1)).check()
    assert status.identity == "vendor 0x0000BEEF, product 0x00000007"


def test_a_device_that_refuses_to_say_what_it_is(slaves, make_link, encoder):
    slaves(1, {(0x6004, 0): 1})
    (status,) = make_link(encoder(1)).check()
    assert not status.answers
    assert "refused reading object 0x1000:0" in status.problem


def test_position_by_sdo(slaves, make_link, encoder):
    slaves(1, ENCODER)
    device = encoder(1)
    make_link(device)
    assert device.position() == 4711


def test_readings_come_on_sync_stamped_on_arrival(slaves, make_link, encoder, clock, pump_until):
    answering(slaves(1, ENCODER))
    answering(slaves(2, ENCODER), plain=True)
    link = make_link(encoder(1), encoder(2))
    link.start(HZ)
    events = []
    for _ in range(5):
        events += pump_until(link, Reading, 2)
        clock.advance(STEP_S)
    link.stop()
    first = [event for event in events if event.channel == "q1"]
    plain = [event for event in events if event.channel == "q2"]
    assert [r.raw for r in first] == [1001, 1002, 1003, 1004, 1005]
    assert [r.sequence for r in first] == [1, 2, 3, 4, 5]
    assert [r.device_time_ns for r in first] == [n * 10_000_000 for n in range(1, 6)]
    assert [r.sequence for r in plain] == [None] * 5
    assert [(b.time_ns - a.time_ns) for a, b in pairwise(first)] == [10_000_000] * 4
    assert link.losses() == {"q1": Losses(5, 0, 0, 0), "q2": Losses(5, 0, 0, 0)}


def test_lost_samples_are_counted(slaves, make_link, encoder, clock, pump_until):
    answering(slaves(1, ENCODER), drop=(3, 4))
    answering(slaves(2, ENCODER))
    link = make_link(encoder(1), encoder(2))
    link.start(HZ)
    got = {"q1": 0, "q2": 0}
    for number in range(1, 7):
        for reading in pump_until(link, Reading, 1 if number in (3, 4) else 2):
            got[reading.channel] += 1
        clock.advance(STEP_S)
    link.stop()
    assert got == {"q1": 4, "q2": 6}
    assert link.losses() == {"q1": Losses(6, 0, 2, 1), "q2": Losses(6, 0, 0, 0)}


def test_instants_that_the_host_missed_by_far_are_a_gap(
    slaves, make_link, encoder, clock, pump_until
):
    answering(slaves(1, ENCODER))
    link = make_link(encoder(1))
    link.start(HZ)
    pump_until(link, Reading)
    clock.advance(30 * STEP_S)
    got = 0
    while link.losses()["q1"].expected < 31:
        got += len(pump_until(link, Reading))
    assert got + link.losses()["q1"].lost_in_gaps == 30
    assert link.losses()["q1"].lost_in_gaps == 19
    assert link.losses()["q1"].gaps == 1


def test_the_balance_holds_while_readings_wait_for_the_pump(
    slaves, make_link, encoder, clock, pump_until
):
    answering(slaves(1, ENCODER))
    device = encoder(1)
    link = make_link(device)
    link.start(HZ)
    pump_until(link, Reading)
    clock.advance(STEP_S)
    for _ in range(3):
        device.position()  # serves the bus meanwhile: SYNC is sent, and a reading arrives
    assert link.losses()["q1"] == Losses(1, 0, 0, 0)
    assert len(link.pump(0.0)) == 1
    assert link.losses()["q1"] == Losses(2, 0, 0, 0)


def test_the_transmission_type_is_set_where_it_is_another(slaves, make_link, encoder):
    pdo = {(0x1801, 1): 0x281, (0x1801, 2): 254, (0x1A01, 1): 0x6004_0020}
    slave = slaves(1, {**ENCODER, **pdo})
    link = make_link(encoder(1, tpdo=2))
    link.start(HZ)
    link.check()  # a round trip: what was sent before has arrived
    assert slave.node.get_data(0x1801, 2) == b"\1"
    assert slave.started


def test_the_second_pdo_is_taken_when_asked_for(slaves, make_link, encoder, pump_until):
    slave = slaves(1, ENCODER)
    slave.on_sync(lambda: slave.send(0x281, struct.pack("<I", 77)))
    link = make_link(encoder(1, tpdo=2))
    link.start(HZ)
    assert pump_until(link, Reading)[0].raw == 77


def test_start_names_a_silent_device(make_link, encoder):
    with pytest.raises(DeviceSilent, match="node 9"):
        make_link(encoder(9)).start(HZ)


def test_an_emergency_is_a_fault_of_its_device(slaves, make_link, encoder, pump_until):
    slave = slaves(1, ENCODER)
    link = make_link(encoder(1))
    link.start(HZ)
    slave.send(0x081, bytes.fromhex("10 81 11 00 00 00 00 00"))
    (fault,) = faults(pump_until(link, Fault))
    assert (fault.source, fault.kind) == ("encoder1", FaultKind.EMERGENCY)
    assert "0x8110 (Monitoring)" in fault.text


def test_malformed_pdos_are_faults_and_not_fatal(slaves, make_link, encoder, pump_until):
    slave = slaves(1, ENCODER)
    link = make_link(encoder(1))
    link.start(HZ)
    slave.send(0x181, b"\1")
    slave.send(0x081, b"\1")
    slave.send(0x581, b"\1")
    answering(slave)
    (fault,) = faults(pump_until(link, Fault))
    assert (fault.source, fault.kind) == ("encoder1", FaultKind.MALFORMED)
    slave.send(0x181, struct.pack("<I", 5))
    assert pump_until(link, Reading)[-1].raw == 5


def test_a_device_that_restarts_is_set_up_again(slaves, make_link, encoder, clock, pump_until):
    slave = slaves(1, ENCODER)
    answering(slave)
    link = make_link(encoder(1))
    link.start(HZ)
    pump_until(link, Reading)
    slave.commands.clear()
    slave.send(0x701, b"\0")
    began, ended = faults(pump_until(link, Fault, 2))
    assert (began.source, began.kind) == ("encoder1", FaultKind.RESTARTED)
    assert (ended.source, ended.kind) == ("encoder1", FaultKind.STARTED)
    pump_until(link, Reading, step=lambda: clock.advance(STEP_S))
    assert slave.started


def test_the_master_shows_that_it_lives_while_it_is_pumped_and_somebody_vouches(
    slaves, make_link, clock
):
    slave = slaves(17, DRIVE)
    beats = []
    slave.network.subscribe(0x77F, lambda _id, data, _t: beats.append(bytes(data)))
    link = make_link(joint(17))
    (drive,) = link.joints.values()
    for vouched_s, expected in ((0.0, 0), (10.0, 16), (0.75, 8)):
        beats.clear()
        drive.vouch(clock.now_ns() + round(vouched_s * 1e9))
        for _ in range(30):
            link.pump(0.0)
            clock.advance(0.05)
        link.check()  # a round trip: what was sent before has arrived
        assert set(beats) <= {b"\5"}
        assert abs(len(beats) - expected) <= (expected > 0)


def test_no_heartbeat_is_sent_where_nobody_heeds_it(slaves, make_link, encoder, clock):
    slave = slaves(1, ENCODER)
    beats = []
    slave.network.subscribe(0x77F, lambda *_: beats.append(1))
    link = make_link(encoder(1))
    for _ in range(5):
        link.pump(0.0)
        clock.advance(0.1)
    link.check()
    assert beats == []


def test_a_drive_reports_what_changes(slaves, make_link, pump_until):
    slave = slaves(17, DRIVE)
    link = make_link(joint(17))
    link.start(HZ)
    for data in ("50 02 00", "50 02 00", "37 02 01", "08 02 01"):
        slave.send(0x191, bytes.fromhex(data))
    slave.send(0x091, bytes.fromhex("11 86 01 00 00 00 00 00"))
    slave.send(0x091, bytes.fromhex("00 00 00 00 00 00 00 00"))
    reports = [e for e in pump_until(link, ModeReport, 5) if isinstance(e, ModeReport)]
    assert [(r.mode, r.error_code) for r in reports] == [
        (Mode.OFF, 0),
        (Mode.POSITION, 0),
        (Mode.FAULT, 0),
        (Mode.FAULT, 0x8611),
        (Mode.FAULT, 0),
    ]
    assert reports[0].joint == "joint1"


def test_a_drive_that_restarts_is_guarded_again(slaves, make_link, pump_until):
    slave = slaves(17, DRIVE)
    link = make_link(joint(17))
    link.start(HZ)
    slave.node.set_data(0x1016, 1, bytes(4))
    slave.send(0x711, b"\0")
    began, ended = faults(pump_until(link, Fault, 2))
    assert (began.source, began.kind) == ("drive17", FaultKind.RESTARTED)
    assert (ended.source, ended.kind) == ("drive17", FaultKind.STARTED)
    assert slave.node.get_data(0x1016, 1) == (127 << 16 | 1000).to_bytes(4, "little")


def test_a_drive_that_cannot_watch_the_master_is_refused(slaves, make_link):
    slaves(17, {key: value for key, value in DRIVE.items() if key[0] != 0x1016})
    with pytest.raises(DeviceRefused, match="heartbeat_timeout_s = 0"):
        make_link(joint(17)).start(HZ)


def test_a_closed_link_says_so(can_port, clock, encoder):
    link = CanLink(can_port, [encoder(1)], clock)
    link.close()
    for use in (link.check, lambda: link.pump(0.0), lambda: link.start(HZ)):
        with pytest.raises(LinkClosed, match=r"open\(\)"):
            use()
    link.open()
    link.close()
    with pytest.raises(LinkClosed):
        link.pump(0.0)
