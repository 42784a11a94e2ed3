"""The joint drive against a CiA 402 state machine on a node of the ``canopen`` package."""

from __future__ import annotations

import threading

import pytest

from drivers.can_link import CanLink
from drivers.canopen.joint import CanopenJoint, JointOptions
from drivers.driver import DeviceSpec
from drivers.errors import BadCommand, DeviceRefused, DeviceSilent, LinkClosed
from recordings.events import Mode
from tests.drivers.patience import PATIENCE_S

DICTIONARY = {
    (0x1000, 0): 0x00020192,
    (0x1016, 1): 0,
    (0x603F, 0): 0,
    (0x6040, 0): 0,
    (0x6041, 0): 0x0250,
    (0x6060, 0): 0,
    (0x6061, 0): 0,
    (0x6064, 0): 123_456,
    (0x6071, 0): 0,
    (0x607A, 0): 0,
}
DISABLED, READY, SWITCHED_ON, ENABLED, FAULT = 0x0250, 0x0231, 0x0233, 0x0237, 0x0218


class Servo:
    """What a drive does with its control word; ``log`` has every write in order."""

    def __init__(self, slave) -> None:
        self.state = DISABLED
        self.control = 0
        self.acknowledged = False
        self.acknowledges = True
        self.obeys = True
        self.lasting_fault = False
        self.log: list[tuple[int, int]] = []
        self._node = slave.node
        slave.node.add_write_callback(self._write)
        slave.node.add_read_callback(self._read)

    def _read(self, index, subindex, od):
        if index == 0x6041:
            return self.state | (0x1000 if self.acknowledged else 0)
        return None

    def _write(self, index, subindex, od, data):
        value = int.from_bytes(data, "little", signed=index in (0x6071, 0x607A))
        self.log.append((index, value))
        if index == 0x6060 and self.obeys:
            self._node.set_data(0x6061, 0, data)
        if index == 0x6040 and self.obeys:
            self._obey(value)

    def _obey(self, control: int) -> None:
        rising, self.control = control & ~self.control, control
        if self.state == FAULT:
            if rising & 0x80 and not self.lasting_fault:
                self.state = DISABLED
            return
        steps = {(DISABLED, 0x06): READY, (READY, 0x07): SWITCHED_ON, (SWITCHED_ON, 0x0F): ENABLED}
        self.state = steps.get((self.state, control & 0x0F), self.state)
        if control & 0x02 == 0:
            self.state = DISABLED
        self.acknowledged = bool(control & 0x10) and (
            self.acknowledged or bool(rising & 0x10 and self.acknowledges)
        )

    def fail(self, code: int, *, lasting: bool = False) -> None:
        self.state, self.lasting_fault = FAULT, lasting
        self._node.set_data(0x603F, 0, code.to_bytes(2, "little"))


@pytest.fixture
def servo(slaves, monkeypatch) -> Servo:
    # It answers from a thread of its own, on a busy computer late.
    monkeypatch.setattr("drivers.canopen.sdo.SDO_TIMEOUT_S", PATIENCE_S)
    return Servo(slaves(17, DICTIONARY))


@pytest.fixture
def link(can_port, clock):
    options = JointOptions.model_validate({"node_id": 17, "heartbeat_timeout_s": 0.5})
    drive = CanopenJoint(DeviceSpec("drive1", "canopen-joint", "bus", "joint1", (), options))
    link = CanLink(can_port, [drive], clock)
    link.open()
    yield link
    link.close()


@pytest.fixture
def drive(link):
    return link.joints["joint1"]


def test_free_is_profile_torque_with_zero_torque_and_guarded(servo, drive):
    drive.set_mode(Mode.FREE)
    assert servo.state == ENABLED
    assert drive.report().mode is Mode.FREE
    assert servo.log == [
        (0x1016, 127 << 16 | 500),
        (0x6071, 0),
        (0x6060, 4),
        (0x6061, 4),
        (0x6040, 0x06),
        (0x6040, 0x07),
        (0x6040, 0x0F),
    ]


def test_position_begins_where_the_joint_is(servo, drive):
    drive.set_mode(Mode.POSITION)
    assert drive.report().mode is Mode.POSITION
    assert servo.log[1:3] == [(0x607A, 123_456), (0x6060, 1)]


def test_a_target_is_a_rising_edge_that_is_acknowledged(servo, drive):
    drive.set_mode(Mode.POSITION)
    servo.log.clear()
    drive.move_to(-70_000)
    drive.move_to(70_000)
    edges = [(0x6040, 0x3F), (0x6040, 0x0F)]
    assert servo.log == [(0x607A, -70_000), *edges, (0x607A, 70_000), *edges]


def test_a_target_that_is_not_taken_is_refused_and_the_next_one_works(servo, drive, monkeypatch):
    monkeypatch.setattr("drivers.canopen.joint.ACKNOWLEDGE_S", 0.05)
    drive.set_mode(Mode.POSITION)
    servo.acknowledges = False
    with pytest.raises(DeviceRefused, match="did not take the target 5 within"):
        drive.move_to(5)
    servo.acknowledges = True
    drive.move_to(6)


def test_torque(servo, drive):
    drive.set_mode(Mode.TORQUE)
    drive.set_torque(-120)
    assert servo.log[-1] == (0x6071, -120)
    assert drive.report().mode is Mode.TORQUE
    drive.set_mode(Mode.FREE)
    assert servo.log[-2] == (0x6060, 4) or (0x6071, 0) in servo.log[-4:]
    assert drive.report().mode is Mode.FREE


def test_off(servo, drive):
    drive.set_mode(Mode.FREE)
    drive.set_mode(Mode.OFF)
    assert servo.state == DISABLED
    assert drive.report().mode is Mode.OFF


def test_commands_that_do_not_fit_the_mode(servo, drive):
    with pytest.raises(BadCommand, match="expected POSITION"):
        drive.move_to(5)
    drive.set_mode(Mode.POSITION)
    with pytest.raises(BadCommand, match="is in mode POSITION, expected TORQUE"):
        drive.set_torque(5)
    with pytest.raises(BadCommand, match="32 bits"):
        drive.move_to(1 << 31)
    with pytest.raises(BadCommand, match="16 bits"):
        drive.set_torque(40_000)
    with pytest.raises(BadCommand, match="told the mode FAULT"):
        drive.set_mode(Mode.FAULT)


def test_a_drive_in_fault_is_not_switched_on_before_it_is_acknowledged(servo, drive):
    servo.fail(0x8611)
    report = drive.report()
    assert (report.mode, report.error_code, report.status) == (Mode.FAULT, 0x8611, FAULT)
    with pytest.raises(DeviceRefused, match=r"error code 0x8611.*OFF to acknowledge"):
        drive.set_mode(Mode.FREE)
    drive.set_mode(Mode.OFF)
    assert drive.report().mode is Mode.OFF
    drive.set_mode(Mode.FREE)
    assert servo.state == ENABLED


def test_a_lasting_fault_counts_as_off_and_shows_itself(servo, drive):
    servo.fail(0x3210, lasting=True)
    drive.set_mode(Mode.OFF)
    report = drive.report()
    assert (report.mode, report.error_code) == (Mode.FAULT, 0x3210)


def test_a_fault_on_the_way_is_told(servo, drive):
    drive.set_mode(Mode.POSITION)
    servo.acknowledges = False
    servo.fail(0x8611)
    with pytest.raises(DeviceRefused, match="did not take the target 5: it is in fault"):
        drive.move_to(5)


def test_a_drive_that_does_not_move_on_is_named(servo, drive, monkeypatch):
    monkeypatch.setattr("drivers.canopen.joint.TRANSITION_S", 0.05)
    servo.obeys = False
    with pytest.raises(
        DeviceRefused, match="stays in SWITCH_ON_DISABLED, expected OPERATION_ENABLED"
    ):
        drive.set_mode(Mode.FREE)


def test_a_report_is_read_again_once_it_is_old(servo, drive, clock):
    drive.set_mode(Mode.FREE)
    servo.state = DISABLED
    assert drive.report().mode is Mode.FREE
    clock.advance(0.21)
    assert drive.report().mode is Mode.OFF


def test_a_missing_drive_is_silent(drive):
    with pytest.raises(DeviceSilent, match="node 17"):
        drive.set_mode(Mode.FREE)


def test_a_closed_link_refuses_commands(servo, link, drive):
    link.close()
    with pytest.raises(LinkClosed):
        drive.set_mode(Mode.FREE)


def test_commands_work_from_other_threads_while_the_link_is_pumped(servo, link, drive):
    stop = threading.Event()
    failures = []

    def pump() -> None:
        while not stop.is_set():
            link.pump(0.02)

    def command() -> None:
        try:
            for mode in (Mode.FREE, Mode.POSITION, Mode.FREE):
                drive.set_mode(mode)
                assert drive.report().mode is mode
        except Exception as error:  # noqa: BLE001 - carried to the test's thread
            failures.append(error)

    pumping = threading.Thread(target=pump)
    commanding = [threading.Thread(target=drive.report), threading.Thread(target=command)]
    pumping.start()
    for thread in commanding:
        thread.start()
    for thread in commanding:
        thread.join()
    stop.set()
    pumping.join()
    assert failures == []
