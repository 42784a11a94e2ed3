"""Status words to states to modes, pinned by the tables of CiA 402 (IEC 61800-7-201)."""

from __future__ import annotations

import pytest

from drivers.canopen.cia402 import State, decode, mode_of, state_of
from drivers.errors import Malformed
from recordings.events import Mode


@pytest.mark.parametrize(
    ("status", "state"),
    [
        (0x0000, State.NOT_READY),
        (0x0250, State.SWITCH_ON_DISABLED),
        (0x0270, State.SWITCH_ON_DISABLED),
        (0x0231, State.READY_TO_SWITCH_ON),
        (0x0233, State.SWITCHED_ON),
        (0x0237, State.OPERATION_ENABLED),
        (0x1637, State.OPERATION_ENABLED),
        (0x0217, State.QUICK_STOP_ACTIVE),
        (0x021F, State.FAULT_REACTION),
        (0x0218, State.FAULT),
        (0x0238, State.FAULT),
    ],
)
def test_states(status: int, state: State):
    assert state_of(status) is state


def test_every_status_word_is_one_state_or_malformed():
    for status in range(0x80):
        fitting = [s for s in State if status & s.value[0] == s.value[1]]
        assert len(fitting) <= 1
        if not fitting:
            with pytest.raises(Malformed):
                state_of(status)


@pytest.mark.parametrize(
    ("state", "display", "torque", "mode"),
    [
        (State.OPERATION_ENABLED, 1, 0, Mode.POSITION),
        (State.OPERATION_ENABLED, 4, 0, Mode.FREE),
        (State.OPERATION_ENABLED, 4, -20, Mode.TORQUE),
        (State.OPERATION_ENABLED, 3, 0, Mode.UNKNOWN),
        (State.SWITCHED_ON, 1, 0, Mode.OFF),
        (State.FAULT, 1, 0, Mode.FAULT),
        (State.FAULT_REACTION, 4, 0, Mode.FAULT),
    ],
)
def test_modes(state: State, display: int, torque: int, mode: Mode):
    assert mode_of(state, display, torque) is mode


@pytest.mark.parametrize(
    ("data", "shown"),
    [
        ("37 02 01", (0x0237, 1)),
        ("37 12 FF", (0x1237, -1)),
        ("50 02", (0x0250, None)),
        ("18 02 04 11 86", (0x0218, 4)),
    ],
)
def test_status_pdos(data: str, shown: tuple[int, int | None]):
    assert decode(bytes.fromhex(data)) == shown


def test_a_status_pdo_without_a_status_word_is_malformed():
    with pytest.raises(Malformed, match="expected 2 or more"):
        decode(b"\x37")
