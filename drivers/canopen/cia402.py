"""The state machine of drives and motion control, device profile CiA 402. Pure.

States by status word 0x6041, commands by control word 0x6040:

    state                 status & mask     control word towards OPERATION_ENABLED
    NOT_READY             xxxx x0xx 0000    (wait)
    SWITCH_ON_DISABLED    xxxx x1xx 0000    0x06 shutdown
    READY_TO_SWITCH_ON    xxxx x01x 0001    0x07 switch on
    SWITCHED_ON           xxxx x01x 0011    0x0F enable operation
    OPERATION_ENABLED     xxxx x01x 0111    (there)
    QUICK_STOP_ACTIVE     xxxx x00x 0111    0x00 disable voltage
    FAULT_REACTION        xxxx x0xx 1111    (wait)
    FAULT                 xxxx x0xx 1000    0x80 fault reset, by its rising edge
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from drivers.errors import Malformed
from recordings.events import Mode

DISABLE_VOLTAGE = 0x00
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE_OPERATION = 0x0F
FAULT_RESET = 0x80
NEW_SET_POINT = 0x10
CHANGE_AT_ONCE = 0x20

SET_POINT_ACKNOWLEDGED = 1 << 12


class Operation(IntEnum):
    """Modes of operation (0x6060, 0x6061) that are used."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_TORQUE = 4


class State(Enum):
    """States of a drive; value: mask and pattern of its status word."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP_ACTIVE = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)


def state_of(status: int) -> State:
    """The state that a status word tells; raises Malformed where it is none."""
    for state in State:
        mask, pattern = state.value
        if status & mask == pattern:
            return state
    raise Malformed(f"the status word 0x{status:04X} is no state of CiA 402")


TOWARDS_ENABLED = {
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY_TO_SWITCH_ON: SWITCH_ON,
    State.SWITCHED_ON: ENABLE_OPERATION,
    State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
}
"""Control word that leads from each state one step towards OPERATION_ENABLED; others wait."""


@dataclass(frozen=True, slots=True)
class DriveState:
    """What a drive showed at ``time_ns``: status word, and mode display where it was shown."""

    status: int
    display: int
    time_ns: int


def decode(data: bytes) -> tuple[int, int | None]:
    """Status word and mode display (None where absent) of a TPDO; raises Malformed."""
    if len(data) < 2:
        raise Malformed(f"a status PDO of {len(data)} bytes ({data.hex()}), expected 2 or more")
    display = int.from_bytes(data[2:3], "little", signed=True) if len(data) > 2 else None
    return int.from_bytes(data[:2], "little"), display


def mode_of(state: State, display: int, torque: int) -> Mode:
    """The mode of a drive.

    Args:
        state: its state.
        display: mode of operation display.
        torque: target torque last commanded; profile torque at 0 is a free joint.
    """
    if state in (State.FAULT, State.FAULT_REACTION):
        return Mode.FAULT
    if state not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
        return Mode.OFF
    if display == Operation.PROFILE_POSITION:
        return Mode.POSITION
    if display == Operation.PROFILE_TORQUE:
        return Mode.TORQUE if torque else Mode.FREE
    return Mode.UNKNOWN
