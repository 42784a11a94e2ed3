"""The states of a session, what each allows, and how one leads to another: two tables.

The tables are the documentation: docs/safety.md shows them, and a test compares. Whatever is
not in them is refused. Every session begins IDLE, and however it ends, it ends through SAFE.
Pure, but for the clock that stamps a change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from daq.clock import Clock
from daq.errors import NotAllowed
from recordings.events import Mode, SessionState, StateChange

IDLE, ARMED, MOVING, RECORDING, SAFE = SessionState


@dataclass(frozen=True, slots=True)
class Allowance:
    """What a session may do in one state. Switching a drive off is allowed in every state.

    Attributes:
        modes: whether drives may be told other modes than off.
        targets: whether drives may be told where to go.
        vouched: whether the session vouches for the drives, which keeps their watchdogs quiet.
        meaning: what the state is, in words.
    """

    modes: bool
    targets: bool
    vouched: bool
    meaning: str


ALLOWED: Mapping[SessionState, Allowance] = {
    IDLE: Allowance(False, False, False, "nobody has armed; drives are off"),
    ARMED: Allowance(True, False, True, "armed: drives take hold, or stand and settle"),
    MOVING: Allowance(False, True, True, "drives are led to the next stop"),
    RECORDING: Allowance(False, False, True, "a dwell is recorded, or the operator moves by hand"),
    SAFE: Allowance(False, False, False, "drives are told to be off, and their watchdogs run out"),
}
"""What each state allows."""


class Step(StrEnum):
    """What can happen to a session."""

    ARM = "arm"
    MOVE = "move"
    RECORD = "record"
    STAND = "stand"
    MAKE_SAFE = "make safe"
    RESET = "reset"


@dataclass(frozen=True, slots=True)
class Transition:
    """One row of the table: ``step`` leads from ``before`` to ``after``, ``when`` says when."""

    before: SessionState
    step: Step
    after: SessionState
    when: str


TRANSITIONS = (
    Transition(IDLE, Step.ARM, ARMED, "the operator armed, or no real drive is to be moved"),
    Transition(ARMED, Step.MOVE, MOVING, "the plan leads the drives to the next stop"),
    Transition(ARMED, Step.RECORD, RECORDING, "the mechanism stands, or is moved by hand"),
    Transition(MOVING, Step.STAND, ARMED, "all targets of the stop are sent"),
    Transition(RECORDING, Step.STAND, ARMED, "the dwell is over, or was disturbed"),
    Transition(IDLE, Step.MAKE_SAFE, SAFE, "the session ends before it was armed"),
    Transition(ARMED, Step.MAKE_SAFE, SAFE, "the session ends, well or not"),
    Transition(MOVING, Step.MAKE_SAFE, SAFE, "the session ends on the way"),
    Transition(RECORDING, Step.MAKE_SAFE, SAFE, "the session ends in a dwell"),
    Transition(SAFE, Step.RESET, IDLE, "every drive has answered that it is off"),
)
"""All transitions. A step that is not here is refused, and nothing changes."""

_AFTER = {(row.before, row.step): row.after for row in TRANSITIONS}


class SessionStates:
    """Which state a session is in. Changed by the session's own thread only; read by any.

    Args:
        clock: stamps the changes.
        record: takes every change.
    """

    def __init__(self, clock: Clock, record: Callable[[StateChange], None]) -> None:
        self._clock = clock
        self._record = record
        self._state = IDLE
        self._changes: list[StateChange] = []

    @property
    def now(self) -> SessionState:
        """The state."""
        return self._state

    @property
    def allowed(self) -> Allowance:
        """What the state allows."""
        return ALLOWED[self._state]

    @property
    def changes(self) -> tuple[StateChange, ...]:
        """All changes so far, in order."""
        return tuple(self._changes)

    def take(self, step: Step, cause: str) -> None:
        """Go on to the state that ``step`` leads to; raises NotAllowed where the table has none."""
        after = _AFTER.get((self._state, step))
        if after is None:
            steps = ", ".join(f"'{row.step}'" for row in TRANSITIONS if row.before is self._state)
            raise NotAllowed(
                f"'{step}' ({cause}) is not possible in the state {self._state.name}, only {steps}"
            )
        change = StateChange(self._clock.now_ns(), self._state, after, cause)
        self._state = after
        self._changes.append(change)
        self._record(change)

    def require_mode(self, joint: str, mode: Mode) -> None:
        """Whether a mode may be commanded now; raises NotAllowed."""
        if mode is not Mode.OFF and not self.allowed.modes:
            raise NotAllowed(
                f"{joint} was to be told {mode.name} in the state {self._state.name}, in which drives may "
                f"only be switched off; modes are told in the state {_where('modes')}"
            )

    def require_target(self, joint: str) -> None:
        """Whether a drive may be sent somewhere now; raises NotAllowed."""
        if not self.allowed.targets:
            raise NotAllowed(
                f"{joint} was to be sent to a target in the state {self._state.name}; drives are "
                f"moved in the state {_where('targets')}"
            )


def _where(what: str) -> str:
    return " or ".join(state.name for state, allowed in ALLOWED.items() if getattr(allowed, what))
