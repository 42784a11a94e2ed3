"""Joint drives whose CAN messages a DBC file describes.

Wire contract: the DBC file that the device names as its ``file``.

    command  sent when something changes, and every cycle while somebody vouches for the drive
             (`drivers.link.JointDrive.vouch`): a drive that watches its command, as it should,
             trips by itself when this program dies
    status   sent by the drive unasked; a mode holds when the status shows it

A drive that does not watch its command message stays powered when this program dies. The DBC
cannot say whether it does: look it up, and try it out with the arm supported.

Options, beside those of `drivers.dbc.drive_messages.DbcDriveOptions`:

    actual_position  signal of the status with the position, in the unit of ``target_position``;
                     needed for the mode "position", which begins by holding where the joint is
    counter          signal of the command that counts the commands
    fixed            other signals of the command and their raw values
    cycle_ms         time between two commands, in place of GenMsgCycleTime
    timeout_s        how long the drive may take to enter a mode, default 2.0; a status older than
                     0.2 s is waited for
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Mapping, Sequence
from typing import ClassVar

from pydantic import Field, model_validator

from drivers.can_bus import Frame
from drivers.can_device import CanWire, Identity
from drivers.can_link import CanLink
from drivers.dbc.drive_messages import DbcDriveOptions, DriveMessages, Report, open_dbc
from drivers.dbc.message_watch import drive_faults, status_watch
from drivers.driver import DeviceSpec, Driver
from drivers.errors import BadCommand, DeviceRefused, DeviceSilent, OptionError
from drivers.joint_drive import joint_of, require_mode
from drivers.link import JointDrive, Losses
from drivers.schedule import SECOND
from drivers.tally import Tally
from drivers.waiting import waits
from recordings.events import Event, Fault, Mode, ModeReport
from recordings.faults import FaultKind
from recordings.rig import CanPort
from recordings.rig.quantity import fail

FRESH_NS = SECOND // 5
STATUS_S = 0.5
"""How long a status is waited for."""


class DbcJointOptions(DbcDriveOptions):
    """Options of a ``dbc-joint``."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"timeout": ("s",)}

    actual_position: str | None = None
    counter: str | None = None
    fixed: dict[str, int] = Field(default_factory=dict)
    cycle_ms: int | None = Field(default=None, ge=1, le=10_000)
    timeout: float = 2.0

    @model_validator(mode="after")
    def _position_can_be_held(self) -> DbcJointOptions:
        if not 0 < self.timeout <= 60:
            raise fail(f"'timeout_s' is {self.timeout}, expected above 0 and at most 60")
        if "position" in self.modes and None in (self.actual_position, self.target_position):
            raise fail(
                "'modes' has \"position\", which needs the signals 'target_position' and "
                "'actual_position': the mode begins by holding the joint where it is"
            )
        if "torque" in self.modes and self.target_torque is None:
            raise fail("'modes' has \"torque\", which needs the signal 'target_torque'")
        return self


class DbcJoint:
    """One joint drive. See `drivers.link.JointDrive` and `drivers.can_device.CanDevice`."""

    sends = True
    service = None
    tallies: Mapping[str, Tally]

    def __init__(self, spec: DeviceSpec[DbcJointOptions]) -> None:
        options = spec.options
        self.joint = joint_of(
            spec, "joint drive", instead="read its position with a device of the driver dbc-encoder"
        )
        self.name = spec.name
        self.driver = spec.driver
        self.channels: tuple[str, ...] = ()
        self.tallies = {}
        self.drive: JointDrive | None = self
        self._messages = DriveMessages(open_dbc(spec.file, spec.name, spec.driver), options)
        command, status = self._messages.command, self._messages.status
        self.identifiers = (status.identifier,)
        self._actual = (
            None if options.actual_position is None else status.signal(options.actual_position)
        )
        self._counter = None if options.counter is None else command.signal(options.counter)
        self._idle = bytes(command.length)
        for name, value in options.fixed.items():
            try:
                self._idle = command.signal(name).layout.put(value, self._idle)
            except ValueError as error:
                raise OptionError(f"device '{spec.name}': 'fixed' says {error}") from error
        period_ns = command.period_ns
        if options.cycle_ms is not None:
            period_ns = options.cycle_ms * 1_000_000
        if period_ns is None:
            raise OptionError(
                f"device '{spec.name}': the DBC does not say how often '{command.name}' is to be "
                f"sent (GenMsgCycleTime); say it as 'cycle_ms'"
            )
        self._period_ns = period_ns
        self._timeout_s = options.timeout
        self._commanding = threading.Lock()
        self._mode, self._target = Mode.OFF, 0
        self._count = 0
        self._commanded = False
        self._sent_ns = 0
        self._vouched_until_ns = 0
        self._latest: tuple[Report, int] | None = None
        self._position: int | None = None
        self._reported: Report | None = None
        self._answers: queue.Queue[bytes] | None = None
        self._status = status_watch(status.period_ns)

    def attach(self, wire: CanWire) -> None:
        """Belong to a bus."""
        self._wire = wire

    def identify(self) -> Identity:
        """Listen until a status comes; raises DeviceSilent or LinkBroken."""
        self._await_status()
        return Identity(f"sends {self._messages.status.name}", virtual=False)

    def start(self) -> None:
        """Nothing is set up; what interrupted it may have tripped it: it is off until told."""
        self._commanded = False
        self._mode, self._target = Mode.OFF, 0
        self._status.begin(self._wire.now_ns())

    def stop(self, now_ns: int) -> None:
        """It delivers no channel."""
        self._status.end()

    def interrupt(self) -> None:
        """The port has gone away: nothing that was commanded holds any more."""
        self._commanded = False
        self._status.end()

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """It delivers no channel."""
        return {}

    def vouch(self, until_ns: int) -> None:
        """See `drivers.link.JointDrive.vouch`: the command is repeated until then."""
        self._vouched_until_ns = until_ns

    def set_mode(self, mode: Mode) -> None:
        """Switch the mode; see `drivers.link.JointDrive.set_mode`."""
        with self._commanding:
            target = 0
            if mode is Mode.POSITION:
                self._await_status()
                target = self._messages.target_of(self._position or 0)
            if mode is not Mode.OFF and self._await_status().mode is Mode.FAULT:
                raise self._faulty("cannot be switched on")
            self._command(mode, target)
            for _ in waits(self._timeout_s, STATUS_S):
                report = self._await_status()
                if report.mode is mode:
                    return
                if report.mode is Mode.FAULT:
                    break
            if report.mode is Mode.FAULT and mode is not Mode.OFF:
                raise self._faulty(f"went into fault on the way to {mode.name}")
            raise DeviceRefused(
                f"{self.name} shows {report.mode.name} (raw {report.status}, error "
                f"{report.error_code}), expected {mode.name} within {self._timeout_s:g} s"
            )

    def move_to(self, target_raw: int) -> None:
        """Move to a target [counts]; see `drivers.link.JointDrive.move_to`."""
        with self._commanding:
            require_mode(self.name, self._mode, Mode.POSITION)
            self._command(Mode.POSITION, target_raw)

    def set_torque(self, permille: int) -> None:
        """Set the torque [per mille of rated]; see `drivers.link.JointDrive.set_torque`."""
        with self._commanding:
            require_mode(self.name, self._mode, Mode.TORQUE)
            self._command(Mode.TORQUE, permille)

    def report(self) -> ModeReport:
        """What it says it is doing, at most 0.2 s old; raises DeviceSilent or LinkBroken."""
        latest = self._latest
        if latest is None or self._wire.now_ns() - latest[1] > FRESH_NS:
            self._await_status()
            latest = self._latest
        if latest is None:
            raise self._mute()
        return _report_of(self.joint, *latest)

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a status; a report when something has changed. Raises Malformed."""
        if self._status.hear(frame.time_ns):
            text = f"{self.name} sends {self._messages.status.name} again"
            fault = Fault(frame.time_ns, self.name, FaultKind.ANSWERING, text)
            return (fault, *self._take_status(frame))
        return self._take_status(frame)

    def _take_status(self, frame: Frame) -> Sequence[Event]:
        report = self._messages.read_status(frame.data)
        if self._actual is not None and (position := self._actual.raw(frame.data)) is not None:
            self._position = position
        if report is None:
            return ()
        self._latest = report, frame.time_ns
        if self._answers is not None:
            self._answers.put(b"")
        if report == self._reported:
            return ()
        self._reported = report
        return (_report_of(self.joint, report, frame.time_ns),)

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Repeat the command when it is due, while somebody vouches for the drive; miss its status."""
        faults = drive_faults(now_ns, self.name, self._messages.status.name, self._status)
        if not self._repeats(now_ns) or now_ns < self._sent_ns + self._period_ns:
            return faults
        try:
            self._send(now_ns)
        except BadCommand as error:
            return (*faults, Fault(now_ns, self.name, FaultKind.REFUSED, str(error)))
        return faults

    def due_ns(self) -> int | None:
        """When the command is to be repeated."""
        repeats = self._repeats(self._wire.now_ns())
        return self._sent_ns + self._period_ns if repeats else None

    def _repeats(self, now_ns: int) -> bool:
        return self._commanded and now_ns < self._vouched_until_ns

    def _command(self, mode: Mode, target: int) -> None:
        before = self._mode, self._target
        self._mode, self._target = mode, target
        try:
            self._send(self._wire.now_ns())
        except BadCommand:
            self._mode, self._target = before
            raise
        self._commanded = True

    def _send(self, now_ns: int) -> None:
        data = self._messages.write_command(self._idle, self._mode, self._target)
        if self._counter is not None:
            layout = self._counter.layout
            data = layout.put(self._count % (1 << (layout.length - layout.signed)), data)
            self._count += 1
        self._wire.send(self._messages.command.identifier, data)
        self._sent_ns = now_ns

    def _await_status(self) -> Report:
        """The next status; raises DeviceSilent or LinkBroken."""
        answers: queue.Queue[bytes] = queue.Queue()
        self._answers = answers
        try:
            self._wire.await_answer(answers, STATUS_S)
        except queue.Empty as error:
            raise self._mute() from error
        finally:
            self._answers = None
        if self._latest is None:
            raise self._mute()
        return self._latest[0]

    def _mute(self) -> DeviceSilent:
        status = self._messages.status
        return DeviceSilent(
            f"{self.name} has not sent {status.name} (identifier "
            f"0x{status.identifier & 0x1FFF_FFFF:X}) within {STATUS_S} s; check the bit rate, power "
            f"and wiring"
        )

    def _faulty(self, complaint: str) -> DeviceRefused:
        code = 0 if self._latest is None else self._latest[0].error_code
        return DeviceRefused(
            f"{self.name} {complaint}: it is in fault with the error {code}; remove the cause, then "
            f"switch it OFF to acknowledge"
        )


def _report_of(joint: str, report: Report, time_ns: int) -> ModeReport:
    return ModeReport(joint, time_ns, report.mode, report.status, report.error_code)


DRIVER = Driver(options=DbcJointOptions, ports=(CanPort,), make=DbcJoint, link=CanLink)
