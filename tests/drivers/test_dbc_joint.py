"""Drives that a DBC file describes: commanded and confirmed, or listened to without a word."""

from __future__ import annotations

from pathlib import Path

import cantools
import pytest

from drivers.can_link import CanLink
from drivers.dbc.drive_messages import DbcDriveOptions
from drivers.dbc.joint import DbcJoint, DbcJointOptions
from drivers.dbc.listener import DbcListener
from drivers.driver import DeviceSpec
from drivers.errors import BadCommand, DeviceRefused, DeviceSilent, OptionError
from recordings.events import Mode, ModeCommand, ModeReport

TEXT = (Path(__file__).parent / "bench.dbc").read_text("utf-8")
THEIRS = cantools.database.load_string(TEXT, "dbc")
COMMAND = THEIRS.get_message_by_name("DriveCommand")
STATUS = THEIRS.get_message_by_name("DriveStatus")
DESCRIPTION = {
    "command": "DriveCommand",
    "status": "DriveStatus",
    "mode": "Mode",
    "reported_mode": "Shown",
    "modes": {"off": 0, "free": 1, "position": 2, "torque": 3},
    "target_position": "Target",
    "target_per_count": 2,
    "target_at_zero": 100,
    "target_torque": "Torque",
    "error": "Error",
}
JOINT = {
    **DESCRIPTION,
    "actual_position": "Actual",
    "counter": "Count",
    "fixed": {"Key": 9},
    "timeout_s": 0.3,
}


class Drive:
    """Obeys its command message at once, and answers with its status."""

    def __init__(self, bus) -> None:
        self.commands: list[dict[str, int]] = []
        self.shown, self.error, self.actual = 0, 0, 4100
        self.obeys = True
        self._bus = bus
        bus.answer = self._take

    def _take(self, message) -> None:
        command = COMMAND.decode(message.data, decode_choices=False, scaling=False)
        self.commands.append(command)
        if self.obeys and not self.error:
            self.shown = command["Mode"]
        self.say()

    def say(self) -> None:
        values = {"Shown": self.shown, "Error": self.error, "Actual": self.actual}
        for _ in range(2):  # whoever waits for a status may have taken one for something else
            self._bus.push(STATUS.frame_id, STATUS.encode(values, scaling=False))


@pytest.fixture
def make(can_port, clock, bus):
    links = []

    def make(kind, options, joint="joint1", text=TEXT, port=can_port):
        device = kind(DeviceSpec("elbow", "dbc", "bus", joint, (), options, text))
        link = CanLink(port, [device], clock, connect=bus.connect)
        links.append(link)
        link.open()
        return link

    yield make
    for link in links:
        link.close()


@pytest.fixture
def drive(bus) -> Drive:
    return Drive(bus)


@pytest.fixture
def link(make, drive):
    link = make(DbcJoint, DbcJointOptions.model_validate(JOINT))
    drive.say()
    return link


@pytest.fixture
def joint(link, drive):
    """The joint; the drive says its status whenever the link looks for it."""
    joint = link.joints["joint1"]
    receive = drive._bus.recv

    def recv(timeout=None):
        if not drive._bus.incoming and drive.says:
            drive.say()
        return receive(timeout)

    drive.says = True
    drive._bus.recv = recv
    return joint


def test_position_mode_begins_where_the_joint_is_and_moves_on_command(joint, drive):
    joint.set_mode(Mode.POSITION)
    assert joint.report().mode is Mode.POSITION
    assert drive.commands[-1] == {"Mode": 2, "Key": 9, "Count": 0, "Target": 4100, "Torque": 0}
    joint.move_to(2500)
    assert drive.commands[-1] == {"Mode": 2, "Key": 9, "Count": 1, "Target": 5100, "Torque": 0}


def test_torque_and_free_and_off(joint, drive):
    with pytest.raises(BadCommand, match="expected TORQUE"):
        joint.set_torque(5)
    joint.set_mode(Mode.TORQUE)
    joint.set_torque(-250)
    assert drive.commands[-1]["Torque"] == -250
    joint.set_mode(Mode.FREE)
    joint.set_mode(Mode.OFF)
    assert [c["Mode"] for c in drive.commands] == [3, 3, 1, 0]
    assert joint.report().mode is Mode.OFF


def test_the_command_is_repeated_only_while_somebody_vouches(link, joint, drive, clock):
    joint.set_mode(Mode.FREE)
    said = len(drive.commands)
    for _ in range(10):
        clock.advance(0.02)
        link.pump(0.0)
    assert len(drive.commands) == said
    joint.vouch(clock.now_ns() + 100_000_000)
    for _ in range(10):
        clock.advance(0.02)
        link.pump(0.0)
    assert len(drive.commands) == said + 4
    assert [c["Count"] for c in drive.commands] == list(range(said + 4))


def test_a_drive_that_does_not_obey_is_named(joint, drive):
    drive.obeys = False
    with pytest.raises(DeviceRefused, match=r"shows OFF .*expected FREE within 0\.3 s"):
        joint.set_mode(Mode.FREE)


def test_a_drive_in_fault_is_not_switched_on_but_can_be_switched_off(joint, drive):
    drive.error = 0x42
    with pytest.raises(DeviceRefused, match="in fault with the error 66"):
        joint.set_mode(Mode.FREE)
    assert (joint.report().mode, joint.report().error_code) == (Mode.FAULT, 0x42)
    drive.error = 0
    joint.set_mode(Mode.OFF)


def test_a_silent_drive_is_named(link, drive):
    drive._bus.incoming.clear()
    (status,) = link.check()
    assert not status.answers
    assert "has not sent DriveStatus (identifier 0x259)" in status.problem
    with pytest.raises(DeviceSilent):
        link.joints["joint1"].report()


def test_a_target_that_does_not_fit_is_not_sent(joint, drive):
    joint.set_mode(Mode.TORQUE)
    said = len(drive.commands)
    with pytest.raises(BadCommand, match="40000 cannot be commanded"):
        joint.set_torque(40_000)
    assert len(drive.commands) == said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"actual_position": None}, "needs the signals 'target_position' and 'actual_position'"),
        ({"target_torque": None}, "needs the signal 'target_torque'"),
        ({"modes": {"free": 1}}, "must say the value of"),
        ({"modes": {"off": 0, "hold": 1}}, "names the mode 'hold'"),
        ({"target_per_count": 0}, "'target_per_count' is 0"),
    ],
)
def test_wrong_options(change, words):
    table = {key: value for key, value in {**JOINT, **change}.items() if value is not None}
    with pytest.raises(ValueError, match=words):
        DbcJointOptions.model_validate(table)


def test_wrong_devices(make, can_port):
    options = DbcJointOptions.model_validate(JOINT)
    with pytest.raises(OptionError, match="which 'joint'"):
        make(DbcJoint, options, joint=None)
    with pytest.raises(OptionError, match="needs the 'file'"):
        make(DbcJoint, options, text=None)
    fixed = DbcJointOptions.model_validate({**JOINT, "fixed": {"Key": 16}})
    with pytest.raises(OptionError, match="'fixed' says Key is 16, expected 0 to 15"):
        make(DbcJoint, fixed)
    quiet = TEXT.replace('BA_ "GenMsgCycleTime" BO_ 600 20;', "")
    with pytest.raises(OptionError, match="say it as 'cycle_ms'"):
        make(DbcJoint, options, text=quiet)
    listening = can_port.model_copy(update={"listen_only": True})
    with pytest.raises(OptionError, match="must be sent frames"):
        make(DbcJoint, options, port=listening)


def test_a_listener_records_what_another_controller_commands(make, bus, can_port, clock):
    options = DbcDriveOptions.model_validate(DESCRIPTION)
    port = can_port.model_copy(update={"listen_only": True})
    link = make(DbcListener, options, port=port)
    assert link.check()[0].answers
    assert link.joints == {}
    link.start(100.0)

    def command(mode: int, target: int = 0, torque: int = 0) -> None:
        values = {"Mode": mode, "Key": 1, "Count": 0, "Target": target, "Torque": torque}
        bus.push(COMMAND.frame_id, COMMAND.encode(values, scaling=False))

    def status(mode: int, error: int = 0) -> None:
        values = {"Shown": mode, "Error": error, "Actual": 0}
        bus.push(STATUS.frame_id, STATUS.encode(values, scaling=False))

    command(0)
    command(0)
    status(0)
    command(2, 5100)
    status(2)
    command(2, 5100)
    command(2, 4900)
    command(3, 0, -30)
    command(9)
    status(2, 7)
    events = link.pump(0.0)
    assert [(e.mode, e.target_raw) for e in events if isinstance(e, ModeCommand)] == [
        (Mode.OFF, None),
        (Mode.POSITION, 2500),
        (Mode.POSITION, 2400),
        (Mode.TORQUE, -30),
        (Mode.UNKNOWN, None),
    ]
    assert "another controller sent DriveCommand" in events[0].cause
    assert [(e.mode, e.error_code) for e in events if isinstance(e, ModeReport)] == [
        (Mode.OFF, 0),
        (Mode.POSITION, 0),
        (Mode.FAULT, 7),
    ]
    link.stop()
    assert bus.sent == []
