"""A virtual joint drive (CiA 402) that moves one joint of the plant.

    0x1000  u32  0x00020192 servo drive
    0x1008  text "loopcal virtual joint drive"
    0x6007  i16  abort connection option code, 1: losing the master is a fault
    0x603F  u16  error code of the present fault, 0 when well
    0x6040  u16  control word
    0x6041  u16  status word
    0x605A  i16  quick stop option code, 6: stop and stay in "quick stop active"
    0x605E  i16  fault reaction option code, 0: the motor is unpowered at once
    0x6060  i8   mode of operation: 0 none, 1 profile position, 4 profile torque
    0x6061  i8   mode of operation display
    0x6064  i32  actual position, raw counts of the channel that senses the joint
    0x6067  u32  position window: counts within which a target is reached
    0x6071  i16  target torque, per mille of rated torque, -1000..1000
    0x607A  i32  target position, raw counts of the same channel, within its count range
    0x6502  u32  supported modes, 0x0009

PDOs by default (all mappable objects: those in the PDOs below, and 0x1001):

    TPDO1 0x180 + id  on every SYNC  0-1 status word, 2 mode display, 3-4 error code
    TPDO2 0x280 + id  off            0-1 status word, 2-5 actual position
    RPDO1 0x200 + id  at once        0-1 control word, 2 mode
    RPDO2 0x300 + id  at once        0-1 control word, 2-5 target position
    RPDO3 0x400 + id  at once        0-1 control word, 2-3 target torque

The control word of a PDO is obeyed last, after the mode or target that came with it, so one
PDO is enough to give a set-point.

What the joint does: unpowered unless operation is enabled. Mode 1 holds the joint where it
was when the mode became active, until a set-point comes: rising edge of control bit 4,
acknowledged by status bit 12; bit 6 makes it relative; set-points are not queued, each takes
effect at once; status bit 10 says that it is reached. Mode 4 pushes with the target torque;
zero torque is a free joint. Mode 0 is free too. Halt (bit 8) and quick stop hold the joint
where it is in mode 1, until a new set-point, and free it otherwise.

Faults come from the plant, and from the bus: the master's heartbeat (0x1016) expires, or the
node is stopped by NMT, while operation is enabled. Then the joint is unpowered, the state is
"fault", an EMCY is sent and 0x603F keeps the code. Unpowered rather than held, because joints
that nobody supervises must not over-constrain a closed loop. Fault reset (rising edge of
bit 7) works once the cause is gone: the plant reports no fault, the master's heartbeat is back.
"""

from __future__ import annotations

import math

from recordings.rig import Channel
from sim_devices.canopen import emergency
from sim_devices.canopen.dictionary import (
    I8,
    I16,
    I32,
    U16,
    U32,
    AbortCode,
    ObjectDictionary,
    Refused,
)
from sim_devices.canopen.drive_states import Control, State, Status, command_of, next_state
from sim_devices.canopen.node import Identity, NmtState, Node
from sim_devices.canopen.pdo import NOT_EXISTING, Mapped, PdoDefaults
from sim_devices.plant_seam import Plant, PlantMode

SERVO_DRIVE = 2 << 16 | 402
PRODUCT_CODE = 402
NO_MODE, PROFILE_POSITION, PROFILE_TORQUE = 0, 1, 4
SUPPORTED_MODES = 1 << (PROFILE_POSITION - 1) | 1 << (PROFILE_TORQUE - 1)
LARGEST_TORQUE = 1000
SMALLEST_WINDOW = 10
WINDOW_NOISES = 8

CONTROL_WORD = Mapped(0x6040, 0, 16)
STATUS_WORD = Mapped(0x6041, 0, 16)
MODE, MODE_DISPLAY = Mapped(0x6060, 0, 8), Mapped(0x6061, 0, 8)
ERROR_CODE = Mapped(0x603F, 0, 16)
POSITION = Mapped(0x6064, 0, 32)
TARGET_TORQUE, TARGET_POSITION = Mapped(0x6071, 0, 16), Mapped(0x607A, 0, 32)
AT_ONCE = 255

POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)


class JointDrive(Node):
    """The drive of ``joint``, whose position ``channel`` senses."""

    def __init__(
        self, node_id: int, device: str, joint: str, channel: Channel, plant: Plant
    ) -> None:
        self._plant = plant
        self._joint = joint
        self._channel = channel
        self._commanded: tuple[PlantMode, int] = ("off", 0)
        self.transmit_pdos = (
            PdoDefaults(1, 0x180 + node_id, 1, (STATUS_WORD, MODE_DISPLAY, ERROR_CODE)),
            PdoDefaults(2, 0x280 + node_id | NOT_EXISTING, 1, (STATUS_WORD, POSITION)),
        )
        self.receive_pdos = (
            PdoDefaults(1, 0x200 + node_id, AT_ONCE, (CONTROL_WORD, MODE)),
            PdoDefaults(2, 0x300 + node_id, AT_ONCE, (CONTROL_WORD, TARGET_POSITION)),
            PdoDefaults(3, 0x400 + node_id, AT_ONCE, (CONTROL_WORD, TARGET_TORQUE)),
        )
        super().__init__(Identity(node_id, device, "joint drive", SERVO_DRIVE, PRODUCT_CODE))

    def _install_application(self, dictionary: ObjectDictionary) -> None:
        self._state = State.SWITCH_ON_DISABLED
        self._control = 0
        self._mode = NO_MODE
        self._fault = 0
        self._target = 0
        self._torque = 0
        self._set_point = 0
        self._acknowledged = False
        self._reached = False
        self._window = max(SMALLEST_WINDOW, math.ceil(WINDOW_NOISES * self._channel.noise))
        self._shown: dict[int, int] = {}
        add = dictionary.add
        add(0x6007, 0, I16, read=1)
        add(0x603F, 0, U16, read=lambda: self._fault, mappable=True)
        add(0x6040, 0, U16, read=lambda: self._control, write=self._obey, mappable=True)
        add(0x6041, 0, U16, read=self._status_word, mappable=True)
        add(0x605A, 0, I16, read=6)
        add(0x605E, 0, I16, read=0)
        add(0x6060, 0, I8, read=lambda: self._mode, write=self._set_mode, mappable=True)
        add(0x6061, 0, I8, read=lambda: self._mode, mappable=True)
        add(0x6064, 0, I32, read=self._position, mappable=True)
        add(0x6067, 0, U32, read=lambda: self._window, write=self._set_window)
        add(0x6071, 0, I16, read=lambda: self._torque, write=self._set_torque, mappable=True)
        add(0x607A, 0, I32, read=lambda: self._target, write=self._set_target, mappable=True)
        add(0x6502, 0, U32, read=SUPPORTED_MODES)

    # Hooks of the node.

    def _on_nmt(self, state: NmtState) -> None:
        if state is NmtState.STOPPED and self._state in POWERED:
            self._fail(emergency.NODE_STOPPED)
        elif state is NmtState.BOOTING and self._state is not State.FAULT:
            self._move(State.SWITCH_ON_DISABLED)

    def _on_master_lost(self) -> None:
        if self._state in POWERED:
            self._fail(emergency.HEARTBEAT_LOST)

    def _on_tick(self) -> None:
        code = self._plant.drive_fault(self._joint)
        if code and self._state is not State.FAULT:
            self._fail(code)
        if self._commanded[0] == "position":
            self._reached = abs(self._off_target()) <= self._window
        self._publish()

    # Objects.

    def _status_word(self) -> int:
        status = self._state.value | Status.REMOTE | Status.VOLTAGE_ENABLED
        if self._acknowledged:
            status |= Status.SET_POINT_ACKNOWLEDGE
        if self._reached:
            status |= Status.TARGET_REACHED
        return int(status)

    def _position(self) -> int:
        return self._plant.sense(self._channel.name)

    def _set_mode(self, mode: int) -> None:
        if mode not in (NO_MODE, PROFILE_POSITION, PROFILE_TORQUE):
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        if mode != self._mode:
            self._mode = mode
            self._hold_here()
            self._actuate()

    def _set_window(self, counts: int) -> None:
        self._window = counts

    def _set_torque(self, permille: int) -> None:
        if abs(permille) > LARGEST_TORQUE:
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        self._torque = permille
        self._actuate()

    def _set_target(self, counts: int) -> None:
        allowed = self._channel.count_range
        if allowed is not None and not allowed[0] <= counts <= allowed[1]:
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        self._target = counts

    # State machine.

    def _obey(self, control: int) -> None:
        rising = control & ~self._control
        falling = self._control & ~control
        self._control = control
        if self._state is State.FAULT:
            if rising & Control.FAULT_RESET:
                self._reset_fault()
        else:
            self._move(next_state(self._state, command_of(control)))
        if (rising | falling) & Control.HALT:
            self._hold_here()
        self._take_set_point(bool(rising & Control.NEW_SET_POINT))
        self._actuate()

    def _move(self, state: State) -> None:
        if state is self._state:
            return
        self._state = state
        self._hold_here()
        self._actuate()

    def _fail(self, code: int) -> None:
        if self._state is State.FAULT:
            return
        self._fault = code
        self.begin_emergency(code)
        self._move(State.FAULT)

    def _reset_fault(self) -> None:
        if self.master_lost or self._plant.drive_fault(self._joint):
            return
        self.end_emergency(self._fault)
        self._fault = 0
        self._move(State.SWITCH_ON_DISABLED)

    # Motion.

    def _take_set_point(self, new: bool) -> None:
        ready = self._state is State.OPERATION_ENABLED and self._mode == PROFILE_POSITION
        if not self._control & Control.NEW_SET_POINT or not ready:
            self._acknowledged = False
        elif new and not self._control & Control.HALT:
            start = self._set_point if self._control & Control.RELATIVE else 0
            self._set_point = start + self._target
            self._acknowledged = True
            self._reached = False

    def _hold_here(self) -> None:
        """Whatever changed, a joint held in position stays where it is until a new set-point."""
        self._set_point = self._position() if self._mode == PROFILE_POSITION else 0
        self._acknowledged = False
        self._reached = False

    def _off_target(self) -> int:
        error = self._position() - self._set_point
        modulus = self._channel.modulus_counts
        if modulus is None:
            return error
        return (error + modulus // 2) % modulus - modulus // 2

    def _wanted(self) -> tuple[PlantMode, int]:
        if self._state not in POWERED:
            return ("off", 0)
        if self._mode == PROFILE_POSITION:
            return ("position", self._set_point)
        halted = self._state is State.QUICK_STOP_ACTIVE or self._control & Control.HALT
        if self._mode == PROFILE_TORQUE and self._torque and not halted:
            return ("torque", self._torque)
        return ("free", 0)

    def _actuate(self) -> None:
        """Tell the plant what has changed, and the master what it maps."""
        wanted = self._wanted()
        if wanted != self._commanded:
            self._commanded = wanted
            self._plant.command(self._joint, *wanted)
        self._publish()

    def _publish(self) -> None:
        shown = {0x6041: self._status_word(), 0x6061: self._mode, 0x603F: self._fault}
        for index, value in shown.items():
            if self._shown.get(index) != value:
                self.object_changed(index)
        self._shown = shown
