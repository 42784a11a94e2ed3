"""The state machine of a drive (CiA 402, "Power drive system finite state automaton"), as a table.

Pure: control word bits -> command, (state, command) -> state, state -> status word bits.
Entering "fault" is the drive's own doing and not in the table. The passing states "not ready to
switch on" and "fault reaction active" take no time in a virtual drive, so they do not exist here.
"""

from __future__ import annotations

from enum import Enum, IntFlag


class State(Enum):
    """States, with the bits of the status word that name them."""

    SWITCH_ON_DISABLED = 0x0040
    READY_TO_SWITCH_ON = 0x0021
    SWITCHED_ON = 0x0023
    OPERATION_ENABLED = 0x0027
    QUICK_STOP_ACTIVE = 0x0007
    FAULT = 0x0008


class Control(IntFlag):
    """Bits of the control word 0x6040."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    QUICK_STOP = 1 << 2
    ENABLE_OPERATION = 1 << 3
    NEW_SET_POINT = 1 << 4
    RELATIVE = 1 << 6
    FAULT_RESET = 1 << 7
    HALT = 1 << 8


class Status(IntFlag):
    """Bits of the status word 0x6041 beside those of the state."""

    VOLTAGE_ENABLED = 1 << 4
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    SET_POINT_ACKNOWLEDGE = 1 << 12


class Command(Enum):
    """What a control word asks of the state machine."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"
    ENABLE_OPERATION = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"


# Transitions of CiA 402 by number; switching on and enabling in one control word (3 and 4
# together) is allowed there. Switch on, where operation is enabled, is "disable operation" (5).
TRANSITIONS: dict[tuple[State, Command], State] = {
    (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 2
    (State.READY_TO_SWITCH_ON, Command.SWITCH_ON): State.SWITCHED_ON,  # 3
    (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 3, 4
    (State.SWITCHED_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 4
    (State.OPERATION_ENABLED, Command.SWITCH_ON): State.SWITCHED_ON,  # 5
    (State.SWITCHED_ON, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 6
    (State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 7
    (State.READY_TO_SWITCH_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 7
    (State.OPERATION_ENABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 8
    (State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 9
    (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 10
    (State.SWITCHED_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 10
    (State.OPERATION_ENABLED, Command.QUICK_STOP): State.QUICK_STOP_ACTIVE,  # 11
    (State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 12
    (State.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 16
}


def command_of(control_word: int) -> Command:
    """What the control word asks (CiA 402, table "Command coding"); fault reset is apart."""
    control = Control(control_word & 0x0F)
    if not control & Control.ENABLE_VOLTAGE:
        return Command.DISABLE_VOLTAGE
    if not control & Control.QUICK_STOP:
        return Command.QUICK_STOP
    if not control & Control.SWITCH_ON:
        return Command.SHUTDOWN
    if not control & Control.ENABLE_OPERATION:
        return Command.SWITCH_ON
    return Command.ENABLE_OPERATION


def next_state(state: State, command: Command) -> State:
    """The state after a command; the same where the command has no effect."""
    return TRANSITIONS.get((state, command), state)
