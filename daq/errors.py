"""The errors of this room: why a capture session could not begin, or had to end.

Every message says what was seen, what was expected and what to do.
"""

from __future__ import annotations

from collections.abc import Sequence


class DaqError(Exception):
    """Root of what this room raises."""


class CannotRecord(DaqError):
    """The recording cannot be put where it was asked for."""


class PlanNotPossible(DaqError):
    """The plan does not fit the rig or its drives."""


class NotArmed(DaqError):
    """Arming was refused, so no joint may be moved."""


class NotReady(DaqError):
    """Ports, devices or channels do not answer.

    Attributes:
        missing: one line for each of them, "<what>: <why>".
    """

    def __init__(self, missing: Sequence[str]) -> None:
        self.missing = tuple(missing)
        count = len(self.missing)
        head = f"{count} part{'s' if count > 1 else ''} of the rig did not answer; nothing was recorded:"
        super().__init__("\n".join([head, *(f"  {line}" for line in self.missing)]))


class StopRequested(DaqError):
    """The operator asked to stop."""


class SessionFailed(DaqError):
    """The session cannot go on: a link, a drive or the recording failed, or nothing stands still.

    Attributes:
        source: link, joint, channel or file that failed.
    """

    def __init__(self, source: str, text: str) -> None:
        self.source = source
        super().__init__(text)


class Interlocked(SessionFailed):
    """An interlock of the rig refuses a command, or was seen to be violated; ``source`` is the joint."""


class ArmingExpired(SessionFailed):
    """Nobody renewed the arming in time."""

    def __init__(self, valid_s: float) -> None:
        super().__init__(
            "arming",
            f"the arming ended: nobody renewed it for {valid_s:g} s; arm again to go on, or arm "
            "for longer (--arm-for, or arming_s in the rig's interlocks)",
        )


class NotAllowed(DaqError):
    """The state of the session does not allow this: a mistake of the program, which makes it safe."""
