"""Joint drives that another controller commands by CANopen (CiA 402): heard, never sent to.

Wire contract (node id n, little-endian), all of it received:

    RPDO k  0x100 * k + 0x100 + n, k = 1 to 4   the objects that option ``rpdo`` says it carries
    SDO     0x600 + n   expedited writes of 0x6040, 0x6060, 0x607A, 0x6071
    TPDO 1  0x180 + n   bytes 0-1 status word, byte 2 mode display if present
    EMCY    0x080 + n   error code
    boot-up 0x700 + n  00   the drive has restarted: what it was told before is forgotten

A command is recorded when control word, mode or target has changed what the drive is told: the
mode follows from the control word and the mode of operation as in `drivers.canopen.cia402`.
Works on a port with ``listen_only``.

Options: ``node_id`` (1 to 127); ``rpdo``: a table of lists, by number of the PDO, of "control",
"mode", "position" (0x607A), "torque" (0x6071), "pad8", "pad16", "pad32". Default:
``{ 1 = ["control", "mode"], 2 = ["control", "position"], 3 = ["control", "torque"] }``.
The device names its ``joint`` and delivers no channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field, field_validator

from drivers.can_bus import Frame
from drivers.can_link import CanLink
from drivers.canopen import cia402
from drivers.canopen.cia402 import Operation, State, decode, mode_of, state_of
from drivers.driver import DeviceSpec, Driver
from drivers.errors import Malformed
from drivers.passive import PassiveDrive
from recordings.events import Event, Fault, Mode, ModeCommand, ModeReport
from recordings.faults import FaultKind
from recordings.rig import CanPort
from recordings.rig.quantity import Described, fail

OBJECTS: Mapping[str, tuple[int, bool]] = {
    "control": (2, False),
    "mode": (1, True),
    "position": (4, True),
    "torque": (2, True),
    "pad8": (1, False),
    "pad16": (2, False),
    "pad32": (4, False),
}
"""What a PDO can carry: bytes, and whether the value is signed."""

WRITTEN = {0x6040: "control", 0x6060: "mode", 0x607A: "position", 0x6071: "torque"}
DEFAULT_RPDO: dict[str, tuple[str, ...]] = {
    "1": ("control", "mode"),
    "2": ("control", "position"),
    "3": ("control", "torque"),
}
EMCY, TPDO1, SDO_REQUEST, HEARTBEAT = 0x080, 0x180, 0x600, 0x700
DOWNLOAD, EXPEDITED = 0x20, 0x02
SWITCHED_ON = 0x0F
"""Control word bits that are all set while operation is to be enabled."""


class ListenerOptions(Described):
    """Options of a ``canopen-listener``."""

    node_id: int = Field(ge=1, le=127)
    rpdo: dict[str, tuple[str, ...]] = Field(default_factory=lambda: dict(DEFAULT_RPDO))

    @field_validator("rpdo", mode="before")
    @classmethod
    def _pdos_are_known(cls, table: object) -> object:
        if not isinstance(table, dict):
            return table
        for number, objects in table.items():
            if number not in ("1", "2", "3", "4"):
                raise fail(f"'rpdo' has the key '{number}', expected 1 to 4")
            unknown = [each for each in objects if each not in OBJECTS]
            if unknown:
                raise fail(
                    f"'rpdo.{number}' names '{unknown[0]}', expected some of {', '.join(OBJECTS)}"
                )
            if sum(OBJECTS[each][0] for each in objects) > 8:
                raise fail(f"'rpdo.{number}' is longer than the 8 bytes of a frame")
        return {number: tuple(objects) for number, objects in table.items()}


class Commanded:
    """What a drive has been told by the objects that were written to it. Pure."""

    def __init__(self) -> None:
        self._control = 0
        self._operation: int | None = None
        self._position: int | None = None
        self._torque = 0
        self._set_point: int | None = None

    @property
    def torque(self) -> int:
        """Target torque last written [per mille of rated]."""
        return self._torque

    def write(self, values: Mapping[str, int]) -> None:
        """Objects were written together, by their names in `OBJECTS`."""
        self._operation = values.get("mode", self._operation)
        self._position = values.get("position", self._position)
        self._torque = values.get("torque", self._torque)
        control = values.get("control", self._control)
        rising = control & ~self._control
        self._control = control
        if rising & cia402.NEW_SET_POINT:
            # A target counts from its set-point on: the drive takes it by the rising edge.
            self._set_point = self._position

    def assume(self, operation: int) -> None:
        """The drive shows this mode of operation; taken as told where nothing was heard of it."""
        if self._operation is None:
            self._operation = operation

    def command(self) -> tuple[Mode, int | None]:
        """Mode and target, as in `recordings.events.ModeCommand`."""
        if self._control & SWITCHED_ON != SWITCHED_ON:
            return Mode.OFF, None
        operation = Operation.NONE if self._operation is None else self._operation
        mode = mode_of(State.OPERATION_ENABLED, operation, self._torque)
        if mode is Mode.POSITION:
            return mode, self._set_point
        return mode, self._torque if mode is Mode.TORQUE else None


class CanopenListener(PassiveDrive):
    """One drive of another controller. See `drivers.can_device.CanDevice`."""

    def __init__(self, spec: DeviceSpec[ListenerOptions]) -> None:
        super().__init__(spec, instead="a listener delivers no channel, name the sensor's device")
        node_id = spec.options.node_id
        self._pdos = {
            0x100 * int(number) + 0x100 + node_id: objects
            for number, objects in spec.options.rpdo.items()
        }
        self._tpdo, self._sdo, self._emcy = TPDO1 + node_id, SDO_REQUEST + node_id, EMCY + node_id
        self._beat = HEARTBEAT + node_id
        self.identifiers = (*self._pdos, self._tpdo, self._sdo, self._emcy, self._beat)
        self._begin()

    def start(self) -> None:
        """The recording begins with what is commanded from now on."""
        self._begin()

    def _begin(self) -> None:
        self._told = Commanded()
        self._command: tuple[Mode, int | None] | None = None
        self._report: ModeReport | None = None
        self._error_code = 0

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a command, a status or an emergency; raises Malformed."""
        if frame.identifier in self._pdos:
            return self._written(_values(self._pdos[frame.identifier], frame.data), frame, "RPDO")
        if frame.identifier == self._sdo:
            return self._written(_sdo_write(frame.data), frame, "SDO")
        if frame.identifier == self._emcy:
            code = int.from_bytes(frame.data[:2], "little")
            self._error_code = code if code >> 8 else 0
            return ()
        if frame.identifier == self._beat:
            return self._booted(frame) if frame.data[:1] == b"\0" else ()
        return self._reported(frame)

    def _booted(self, frame: Frame) -> Sequence[Event]:
        self._begin()
        text = f"{self.name} has restarted by itself"
        goes_on = f"{self.name} goes on; setting it up is its controller's affair"
        return (
            Fault(frame.time_ns, self.name, FaultKind.RESTARTED, text),
            Fault(frame.time_ns, self.name, FaultKind.STARTED, goes_on),
        )

    def _written(self, values: Mapping[str, int], frame: Frame, way: str) -> Sequence[Event]:
        if not values:
            return ()
        self._told.write(values)
        command = self._told.command()
        if command == self._command:
            return ()
        self._command = command
        said = ", ".join(f"{name} {value}" for name, value in values.items())
        cause = f"another controller sent, by {way}: {said}"
        return (ModeCommand(self.joint, frame.time_ns, *command, cause),)

    def _reported(self, frame: Frame) -> Sequence[Event]:
        status, display = decode(frame.data)
        state = state_of(status)
        if display is not None:
            self._told.assume(display)
        mode = mode_of(state, display or Operation.NONE, self._told.torque)
        error_code = self._error_code if mode is Mode.FAULT else 0
        report = ModeReport(self.joint, frame.time_ns, mode, status, error_code)
        last, self._report = self._report, report
        if last is not None and (last.mode, last.status, last.error_code) == (
            mode,
            status,
            error_code,
        ):
            return ()
        return (report,)


def _values(objects: Sequence[str], data: bytes) -> dict[str, int]:
    """Values of a PDO's objects by name; raises Malformed where it is too short."""
    values, at = {}, 0
    for name in objects:
        size, signed = OBJECTS[name]
        if at + size > len(data):
            raise Malformed(f"a PDO of {len(data)} bytes, expected {' + '.join(objects)}")
        if not name.startswith("pad"):
            values[name] = int.from_bytes(data[at : at + size], "little", signed=signed)
        at += size
    return values


def _sdo_write(data: bytes) -> dict[str, int]:
    """The object that an expedited SDO request writes, by name; nothing where it is another."""
    if len(data) != 8 or data[0] & 0xE0 != DOWNLOAD or not data[0] & EXPEDITED:
        return {}
    name = WRITTEN.get(int.from_bytes(data[1:3], "little"))
    if name is None or data[3] != 0:
        return {}
    size, signed = OBJECTS[name]
    return {name: int.from_bytes(data[4 : 4 + size], "little", signed=signed)}


DRIVER = Driver(options=ListenerOptions, ports=(CanPort,), make=CanopenListener, link=CanLink)
