"""Joint drives that another controller commands by messages of a DBC file: heard, never sent to.

The other controller's commands are recorded as mode commands, and what the drive answers as
mode reports, each when something in it changes. Works on a port with ``listen_only``.

Options: those of `drivers.dbc.drive_messages.DbcDriveOptions`. The device names its ``joint``
and its ``file``, and delivers no channel.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.can_bus import Frame
from drivers.can_link import CanLink
from drivers.dbc.drive_messages import Command, DbcDriveOptions, DriveMessages, Report, open_dbc
from drivers.dbc.message_watch import drive_faults, status_watch
from drivers.driver import DeviceSpec, Driver
from drivers.passive import PassiveDrive
from recordings.events import Event, Fault, ModeCommand, ModeReport
from recordings.faults import FaultKind
from recordings.rig import CanPort


class DbcListener(PassiveDrive):
    """One drive of another controller. See `drivers.can_device.CanDevice`."""

    def __init__(self, spec: DeviceSpec[DbcDriveOptions]) -> None:
        super().__init__(spec, instead="read it with a device of the driver dbc-encoder")
        self._messages = DriveMessages(open_dbc(spec.file, spec.name, spec.driver), spec.options)
        self.identifiers = (self._messages.command.identifier, self._messages.status.identifier)
        self._commanded: Command | None = None
        self._reported: Report | None = None
        self._status = status_watch(self._messages.status.period_ns)

    def start(self) -> None:
        """The recording begins with what is commanded then."""
        self._status.begin(self._wire.now_ns())
        self._commanded = None
        self._reported = None

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a command or a status; raises Malformed."""
        if frame.identifier == self._messages.command.identifier:
            command = self._messages.read_command(frame.data)
            if command is None or command == self._commanded:
                return ()
            self._commanded = command
            cause = f"another controller sent {self._messages.command.name} {frame.data.hex()}"
            return (ModeCommand(self.joint, frame.time_ns, command.mode, command.target, cause),)
        events: list[Event] = []
        if self._status.hear(frame.time_ns):
            text = f"{self.name} sends {self._messages.status.name} again"
            events.append(Fault(frame.time_ns, self.name, FaultKind.ANSWERING, text))
        report = self._messages.read_status(frame.data)
        if report is None or report == self._reported:
            return events
        self._reported = report
        return (
            *events,
            ModeReport(self.joint, frame.time_ns, report.mode, report.status, report.error_code),
        )

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Nothing is sent; the drive's status may be missed."""
        return drive_faults(now_ns, self.name, self._messages.status.name, self._status)

    def stop(self, now_ns: int) -> None:
        """Nothing is missed any more."""
        self._status.end()

    def interrupt(self) -> None:
        """The port has gone away."""
        self._status.end()


DRIVER = Driver(options=DbcDriveOptions, ports=(CanPort,), make=DbcListener, link=CanLink)
