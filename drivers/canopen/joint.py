"""Joint drives by CANopen, device profile CiA 402.

Wire contract (node id n, little-endian; all commands by SDO):

    0x6040  u16  control word, see `drivers.canopen.cia402`
    0x6041  u16  status word
    0x6060  i8   mode of operation: 1 profile position, 4 profile torque
    0x6061  i8   mode of operation display
    0x6064  i32  actual position [counts of the channel that senses the joint]
    0x607A  i32  target position [the same]; taken by control bit 4, acknowledged by status bit 12
    0x6071  i16  target torque [per mille of rated torque]
    0x603F  u16  error code, read when the drive is in fault
    0x1016:1 u32 heartbeat consumer: master_id << 16 | time [ms]
    0x1017  u16  heartbeat producer [ms]: set to 200; a drive that refuses is not watched
    heartbeat 0x700 + n  missing for 1 s: the drive is silent; too many: there are two of them
    TPDO1 0x180 + n  bytes 0-1 status word, byte 2 mode display if present; on SYNC or event

FREE is profile torque with target torque 0. A drive is switched on only after its heartbeat
consumer has been set and a first beat sent, which begins its watch: it falls into its safe state
by itself when this program dies, hangs or no longer vouches for it (`JointDrive.vouch`);
``heartbeat_timeout_s = 0`` says that the drive has no such thing, or has it set up already.

Options: ``node_id`` (1 to 127), ``master_id`` (default 127), ``heartbeat_timeout_s``
(default 1.0). The device names its ``joint`` and delivers no channel.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

from pydantic import Field, model_validator

from drivers.can_bus import Frame
from drivers.can_device import Identity
from drivers.can_link import CanLink
from drivers.canopen import cia402
from drivers.canopen.beat import BEAT_MS, SILENT_NS, BeatWatch
from drivers.canopen.cia402 import DriveState, Operation, State, decode, mode_of, state_of
from drivers.canopen.device import Wire
from drivers.canopen.identity import identify
from drivers.canopen.master import HEARTBEAT, NMT, NMT_START, OPERATIONAL, CanopenMaster
from drivers.canopen.sdo import SDO_TIMEOUT_S, Sdo
from drivers.driver import DeviceSpec, Driver
from drivers.errors import BadCommand, DeviceRefused
from drivers.joint_drive import joint_of, require_mode
from drivers.link import JointDrive, Losses
from drivers.schedule import SECOND
from drivers.tally import Tally
from drivers.waiting import waits
from recordings.events import Event, Fault, Mode, ModeReport
from recordings.faults import FaultKind
from recordings.rig import CanPort
from recordings.rig.quantity import Described, fail

PROFILE = 402
SHORTEST_HEARTBEAT_S = 0.3
"""Three periods of the master's heartbeat."""

TRANSITION_S = 2.0
"""How long a drive may take to change its state: brakes and capacitors need their time."""

ACKNOWLEDGE_S = 0.5
FRESH_NS = SECOND // 5


class JointOptions(Described):
    """Options of a ``canopen-joint``."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"heartbeat_timeout": ("s",)}

    node_id: int = Field(ge=1, le=127)
    master_id: int = Field(default=127, ge=1, le=127)
    heartbeat_timeout: float = 1.0

    @model_validator(mode="after")
    def _heartbeat_can_be_kept(self) -> JointOptions:
        timeout_s = self.heartbeat_timeout
        if timeout_s != 0 and not SHORTEST_HEARTBEAT_S <= timeout_s <= 65.535:
            raise fail(
                f"'heartbeat_timeout_s' is {timeout_s}, expected 0 (none) or "
                f"{SHORTEST_HEARTBEAT_S} to 65.535"
            )
        return self


class CanopenJoint:
    """One joint drive. See `drivers.link.JointDrive` and `drivers.canopen.device.CanopenDevice`."""

    tallies: Mapping[str, Tally]
    sends = True
    service = CanopenMaster

    def __init__(self, spec: DeviceSpec[JointOptions]) -> None:
        self.joint = joint_of(
            spec, "joint drive", instead="a drive delivers no channel, name the sensor's device"
        )
        self.name = spec.name
        self.driver = spec.driver
        self.node_id = spec.options.node_id
        self._master_id = spec.options.master_id
        self.master_id: int | None = self._master_id
        self.identifiers = (0x180 + self.node_id, HEARTBEAT + self.node_id)
        self.channels: tuple[str, ...] = ()
        self.tallies = {}
        self.drive: JointDrive | None = self
        self._heartbeat_ms = round(spec.options.heartbeat_timeout * 1000)
        self._guarded = False
        self._commanding = threading.Lock()
        self._mode = Mode.UNKNOWN
        self._torque = 0
        self._error_code = 0
        self._latest: DriveState | None = None
        self._reported: ModeReport | None = None
        self._beats = BeatWatch()

    def attach(self, wire: Wire) -> None:
        """Belong to a bus."""
        self._wire = wire
        self._sdo: Sdo = wire.sdo(self.node_id)

    def identify(self) -> Identity:
        """Ask it who it is; raises DeviceSilent, DeviceRefused or LinkBroken."""
        return identify(self._sdo, PROFILE, "drive")

    def start(self) -> None:
        """Have it watch the master and report its state; raises as `identify`."""
        with self._commanding:
            # What interrupted it may have cost it its power, and its settings with that.
            self._guarded = False
            self._guard()
            self._ask_for_beats()
        self._wire.send(NMT, bytes([NMT_START, self.node_id]))

    def set_mode(self, mode: Mode) -> None:
        """Switch the mode; see `drivers.link.JointDrive.set_mode`."""
        with self._commanding:
            if mode is Mode.OFF:
                self._switch_off()
            elif mode is Mode.POSITION:
                self._switch_on(Operation.PROFILE_POSITION)
            elif mode in (Mode.FREE, Mode.TORQUE):
                self._switch_on(Operation.PROFILE_TORQUE)
            else:
                raise BadCommand(
                    f"{self.name} was told the mode {mode.name}; "
                    f"expected OFF, FREE, POSITION or TORQUE"
                )
            self._mode = mode

    def move_to(self, target_raw: int) -> None:
        """Move to a target [counts]; see `drivers.link.JointDrive.move_to`."""
        if not -(1 << 31) <= target_raw < 1 << 31:
            raise BadCommand(f"{self.name}: the target {target_raw} does not fit 32 bits")
        with self._commanding:
            require_mode(self.name, self._mode, Mode.POSITION)
            self._sdo.write(0x607A, 0, target_raw, size=4)
            new = cia402.ENABLE_OPERATION | cia402.CHANGE_AT_ONCE | cia402.NEW_SET_POINT
            self._sdo.write(0x6040, 0, new, size=2)
            try:
                self._wait_for(
                    lambda shown: bool(shown.status & cia402.SET_POINT_ACKNOWLEDGED),
                    ACKNOWLEDGE_S,
                    f"did not take the target {target_raw}",
                )
            finally:
                # The next target needs a rising edge of the bit, whatever became of this one.
                self._sdo.write(0x6040, 0, cia402.ENABLE_OPERATION, size=2)

    def set_torque(self, permille: int) -> None:
        """Set the torque [per mille of rated]; see `drivers.link.JointDrive.set_torque`."""
        if not -(1 << 15) <= permille < 1 << 15:
            raise BadCommand(f"{self.name}: the torque {permille} does not fit 16 bits")
        with self._commanding:
            require_mode(self.name, self._mode, Mode.TORQUE)
            self._sdo.write(0x6071, 0, permille, size=2)
            self._torque = permille

    def vouch(self, until_ns: int) -> None:
        """See `drivers.link.JointDrive.vouch`."""
        self._wire.vouch(until_ns)

    def report(self) -> ModeReport:
        """What it says it is doing, at most 0.2 s old; raises as `identify`."""
        shown = self._latest
        if shown is None or self._wire.now_ns() - shown.time_ns > FRESH_NS:
            shown = self._read()
        if state_of(shown.status) is State.FAULT and not self._error_code:
            self._error_code = self._sdo.read_integer(0x603F)
        return self._report_of(shown)

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a status PDO or a beat; a report when something has changed. Raises Malformed."""
        if frame.identifier == HEARTBEAT + self.node_id:
            return self._hear(frame)
        status, display = decode(frame.data)
        state_of(status)
        if display is None:
            # The drive does not show its mode by PDO: what SDO showed last still holds.
            display = Operation.NONE if self._latest is None else self._latest.display
        self._latest = DriveState(status, display, frame.time_ns)
        return self._changes(self._latest)

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Whatever is sent to it is a command or the master's heartbeat; its own may be missing."""
        events = []
        if self._beats.falls_silent(now_ns):
            text = (
                f"{self.name} (node {self.node_id}) has not been heard for {SILENT_NS / SECOND:g} s"
            )
            events.append(Fault(now_ns, self.name, FaultKind.SILENT, text))
        if self._beats.doubles(now_ns):
            kind = FaultKind.DUPLICATED if self._beats.doubled else FaultKind.SINGLE
            text = (
                f"two devices answer as node {self.node_id}, which is {self.name}: switch off the "
                f"drives, and give one of them another node id"
                if self._beats.doubled
                else f"only one device answers as node {self.node_id} again"
            )
            events.append(Fault(now_ns, self.name, kind, text))
        return events

    def due_ns(self) -> int | None:
        """See `serve`."""
        return None

    def stop(self, now_ns: int) -> None:
        """It delivers no channel."""

    def interrupt(self) -> None:
        """The port has gone away; `start` sets it up anew."""
        self._beats.end()

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """It delivers no channel."""
        return {}

    def sync(self, time_ns: int) -> Sequence[Event]:
        """SYNC asks nothing of a drive: it may report by event."""
        return ()

    def emergency(self, code: int, time_ns: int) -> Sequence[Event]:
        """It reported an error, or that it has none any more."""
        self._error_code = code if code >> 8 else 0
        if self._latest is None:
            return ()
        return self._changes(DriveState(self._latest.status, self._latest.display, time_ns))

    def restarted(self) -> None:
        """It has booted: it is off, and nobody guards it."""
        self._guarded = False
        self._mode = Mode.OFF
        self._latest = None

    def _changes(self, shown: DriveState) -> Sequence[Event]:
        report = self._report_of(shown)
        last = self._reported
        if last is not None and (last.mode, last.status, last.error_code) == (
            report.mode,
            report.status,
            report.error_code,
        ):
            return ()
        self._reported = report
        return (report,)

    def _report_of(self, shown: DriveState) -> ModeReport:
        state = state_of(shown.status)
        mode = mode_of(state, shown.display, self._torque)
        error_code = self._error_code if mode is Mode.FAULT else 0
        return ModeReport(self.joint, shown.time_ns, mode, shown.status, error_code)

    def _hear(self, frame: Frame) -> Sequence[Event]:
        booted = frame.data[:1] == b"\0"
        if booted or not self._beats.hear(frame.time_ns):
            return ()
        text = f"{self.name} (node {self.node_id}) is heard again"
        return (Fault(frame.time_ns, self.name, FaultKind.ANSWERING, text),)

    def _ask_for_beats(self) -> None:
        try:
            self._sdo.write(0x1017, 0, BEAT_MS, size=2)
        except DeviceRefused:
            # Not every drive has a heartbeat; it is then missed when it does not obey.
            return
        self._beats.begin(self._wire.now_ns())

    def _guard(self) -> None:
        if self._guarded or not self._heartbeat_ms:
            return
        try:
            self._sdo.write(0x1016, 1, self._master_id << 16 | self._heartbeat_ms, size=4)
        except DeviceRefused as error:
            raise DeviceRefused(
                f"{self.name} refuses to watch the master's heartbeat ({error}); without it the "
                f"joint would stay powered if this program died. If the drive is guarded in "
                f"another way, set heartbeat_timeout_s = 0"
            ) from error
        # The watch of CiA 301 begins with the first beat: no drive is ever powered without.
        self._wire.send(HEARTBEAT + self._master_id, bytes([OPERATIONAL]))
        self._guarded = True

    def _switch_on(self, operation: Operation) -> None:
        self._guard()
        if state_of(self._read().status) in (State.FAULT, State.FAULT_REACTION):
            raise self._faulty("cannot be switched on")
        if operation is Operation.PROFILE_TORQUE:
            self._sdo.write(0x6071, 0, 0, size=2)
            self._torque = 0
        else:
            here = self._sdo.read_integer(0x6064, signed=True)
            self._sdo.write(0x607A, 0, here, size=4)
        self._sdo.write(0x6060, 0, int(operation), size=1)
        self._walk(State.OPERATION_ENABLED, lambda state: cia402.TOWARDS_ENABLED.get(state))
        self._wait_for(
            lambda shown: shown.display == operation,
            TRANSITION_S,
            f"does not enter the mode of operation {int(operation)}",
        )

    def _switch_off(self) -> None:
        self._sdo.write(0x6040, 0, cia402.DISABLE_VOLTAGE, size=2)
        if state_of(self._read().status) is State.FAULT:
            # A fault whose cause lasts cannot be reset; the drive is unpowered all the same.
            self._sdo.write(0x6040, 0, cia402.FAULT_RESET, size=2)
            self._sdo.write(0x6040, 0, cia402.DISABLE_VOLTAGE, size=2)
            if state_of(self._read().status) is State.FAULT:
                return
        self._error_code = 0
        self._walk(State.SWITCH_ON_DISABLED, lambda state: None)

    def _walk(self, goal: State, command: Callable[[State], int | None]) -> None:
        """Give the control words that lead to ``goal``, each once a state, until it is reached."""
        commanded: State | None = None
        for _ in waits(TRANSITION_S, SDO_TIMEOUT_S):
            state = state_of(self._read().status)
            if state is goal:
                return
            if state is State.FAULT:
                raise self._faulty(f"went into fault on the way to {goal.name}")
            word = command(state)
            if word is not None and state is not commanded:
                self._sdo.write(0x6040, 0, word, size=2)
                commanded = state
        raise DeviceRefused(
            f"{self.name} stays in {state.name}, expected {goal.name} within "
            f"{TRANSITION_S} s; check its power and its enable input"
        )

    def _wait_for(
        self, holds: Callable[[DriveState], bool], timeout_s: float, complaint: str
    ) -> None:
        for _ in waits(timeout_s, SDO_TIMEOUT_S):
            shown = self._read()
            if holds(shown):
                return
            if state_of(shown.status) is State.FAULT:
                raise self._faulty(complaint)
        raise DeviceRefused(
            f"{self.name} {complaint} within {timeout_s} s "
            f"(status word 0x{shown.status:04X}, mode display {shown.display})"
        )

    def _faulty(self, complaint: str) -> DeviceRefused:
        self._error_code = self._sdo.read_integer(0x603F)
        return DeviceRefused(
            f"{self.name} {complaint}: it is in fault with the error code "
            f"0x{self._error_code:04X}; remove the cause, then switch it OFF to acknowledge"
        )

    def _read(self) -> DriveState:
        """State and mode by SDO: what it shows now, whatever PDOs are under way."""
        status = self._sdo.read_integer(0x6041)
        display = self._sdo.read_integer(0x6061, signed=True)
        self._latest = DriveState(status, display, self._wire.now_ns())
        return self._latest


DRIVER = Driver(options=JointOptions, ports=(CanPort,), make=CanopenJoint, link=CanLink)
