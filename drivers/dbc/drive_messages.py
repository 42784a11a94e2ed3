"""The command and status messages of a joint drive that a DBC file describes. Pure.

What the driver that commands (`drivers.dbc.joint`) and the one that only listens
(`drivers.dbc.listener`) both need: which mode a frame tells, with which target.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import Field, model_validator

from drivers.dbc.database import DbcFile, DbcMessage, DbcSignal
from drivers.errors import BadCommand, OptionError
from recordings.events import Mode
from recordings.rig.quantity import Described, fail

MODES = {"off": Mode.OFF, "free": Mode.FREE, "position": Mode.POSITION, "torque": Mode.TORQUE}
"""Names of modes in a rig."""

REPORTED = {**MODES, "fault": Mode.FAULT}


class DbcDriveOptions(Described):
    """Options that ``dbc-joint`` and ``dbc-listener`` share.

    Attributes:
        command: message that commands the drive.
        status: message in which it reports.
        mode: signal of the command that says the mode.
        reported_mode: signal of the status that says the mode.
        modes: raw value of ``mode`` for each of "off", "free", "position", "torque" that exists.
        reported_modes: the same of ``reported_mode``, with "fault" where it exists; by default
            as ``modes``.
        target_position: signal of the command with the target, in counts of the channel that
            senses the joint, times ``target_per_count``, plus ``target_at_zero``.
        target_torque: signal of the command with the torque [per mille of rated torque].
        error: signal of the status that is not 0 when the drive is in fault.
    """

    command: str
    status: str
    mode: str
    reported_mode: str
    modes: dict[str, int]
    reported_modes: dict[str, int] = Field(default_factory=dict)
    target_position: str | None = None
    target_per_count: float = 1.0
    target_at_zero: float = 0.0
    target_torque: str | None = None
    error: str | None = None

    @model_validator(mode="after")
    def _modes_are_known(self) -> DbcDriveOptions:
        for key, table, known in (
            ("modes", self.modes, MODES),
            ("reported_modes", self.reported_modes, REPORTED),
        ):
            for name in table:
                if name not in known:
                    raise fail(
                        f"'{key}' names the mode '{name}', expected some of {', '.join(known)}"
                    )
        if "off" not in self.modes:
            raise fail("'modes' must say the value of \"off\": the safe mode must be known")
        if self.target_per_count == 0:
            raise fail("'target_per_count' is 0, expected another number")
        return self


@dataclass(frozen=True, slots=True)
class Command:
    """What a command message tells a drive; ``target`` as in `recordings.events.ModeCommand`."""

    mode: Mode
    target: int | None


@dataclass(frozen=True, slots=True)
class Report:
    """What a status message says: mode, raw mode value, error value (0: none)."""

    mode: Mode
    status: int
    error_code: int


class DriveMessages:
    """The two messages of one drive.

    Raises:
        OptionError: the DBC has no such message or signal.
    """

    def __init__(self, dbc: DbcFile, options: DbcDriveOptions) -> None:
        self.command: DbcMessage = dbc.message(options.command)
        self.status: DbcMessage = dbc.message(options.status)
        self._mode = self.command.signal(options.mode)
        self._reported_mode = self.status.signal(options.reported_mode)
        self._position = _signal(self.command, options.target_position)
        self._torque = _signal(self.command, options.target_torque)
        self._error = _signal(self.status, options.error)
        self._values = {MODES[name]: value for name, value in options.modes.items()}
        reported = options.reported_modes or options.modes
        self._meaning = {value: REPORTED[name] for name, value in reported.items()}
        self._commanded = {value: mode for mode, value in self._values.items()}
        self._per_count, self._at_zero = options.target_per_count, options.target_at_zero

    @property
    def modes(self) -> Mapping[Mode, int]:
        """The modes that can be commanded, with their raw values."""
        return self._values

    @property
    def takes_position(self) -> bool:
        """Whether a target position can be commanded."""
        return self._position is not None

    def read_command(self, data: bytes) -> Command | None:
        """What a command frame tells, None where it has no mode; raises Malformed."""
        raw = self._mode.raw(data)
        if raw is None:
            return None
        mode = self._commanded.get(raw, Mode.UNKNOWN)
        target = None
        if mode is Mode.POSITION and self._position is not None:
            value = self._position.raw(data)
            if value is not None:
                target = round((value - self._at_zero) / self._per_count)
        elif mode is Mode.TORQUE and self._torque is not None:
            target = self._torque.raw(data)
        return Command(mode, target)

    def read_status(self, data: bytes) -> Report | None:
        """What a status frame says, None where it has no mode; raises Malformed."""
        raw = self._reported_mode.raw(data)
        if raw is None:
            return None
        error = 0 if self._error is None else self._error.raw(data) or 0
        mode = Mode.FAULT if error else self._meaning.get(raw, Mode.UNKNOWN)
        return Report(mode, raw % (1 << 32), error % (1 << 32))

    def write_command(self, data: bytes, mode: Mode, target: int) -> bytes:
        """``data`` with a mode and target in place.

        Raises:
            BadCommand: the mode cannot be commanded, or the target does not fit its signal.
        """
        if mode not in self._values:
            known = ", ".join(each.name for each in self._values)
            raise BadCommand(f"the drive knows no mode {mode.name}; the rig gives it: {known}")
        try:
            data = self._mode.layout.put(self._values[mode], data)
            if self._position is not None:
                position = round(target * self._per_count + self._at_zero)
                data = self._position.layout.put(position if mode is Mode.POSITION else 0, data)
            if self._torque is not None:
                data = self._torque.layout.put(target if mode is Mode.TORQUE else 0, data)
        except ValueError as error:
            raise BadCommand(f"the target {target} cannot be commanded: {error}") from error
        return data

    def target_of(self, position: int) -> int:
        """Counts whose target position is nearest to the raw value ``position``."""
        return round((position - self._at_zero) / self._per_count)


def _signal(message: DbcMessage, name: str | None) -> DbcSignal | None:
    return None if name is None else message.signal(name)


def open_dbc(text: str | None, device: str, driver: str) -> DbcFile:
    """The DBC that a device names; raises OptionError where it names none, or it is none."""
    if text is None:
        raise OptionError(f"device '{device}' ({driver}) needs the 'file' of its DBC")
    return DbcFile(text, f"the file of device '{device}'")
