"""What a session shows while it runs: one frozen snapshot, a few times a second.

Owns the snapshot, not its rendering.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from recordings.events import Fault, SessionState


class Phase(StrEnum):
    """What a session is doing."""

    STARTING = "starting"
    HOLDING = "taking hold"
    MOVING = "moving"
    SETTLING = "settling"
    DWELLING = "dwelling"
    WAITING = "waiting for the operator"
    STOPPING = "stopping"


@dataclass(frozen=True, slots=True)
class ChannelProgress:
    """One channel right now.

    Attributes:
        name: channel of the rig.
        rate_hz: readings that came in the last second.
        received: readings handed to the file so far.
        lost: readings that did not get there: dropped by device or host, or lost in gaps.
    """

    name: str
    rate_hz: float
    received: int
    lost: int


@dataclass(frozen=True, slots=True)
class Progress:
    """A session right now.

    Attributes:
        phase: what it is doing.
        stop: number of the stop under way or awaited, from 1; 0 before the first.
        stops: number of stops that the plan asks for.
        dwells: dwells recorded so far.
        elapsed_s: time since the recording began.
        channels: one entry a channel, in the order of the rig.
        faults: number of faults so far.
        latest_fault: the newest fault kept, or None.
        hint: what comes next, or what the operator is asked to do.
        state: which state the session is in.
        armed_s: how long the arming still lasts [s], or None where none is needed.
    """

    phase: Phase
    stop: int
    stops: int
    dwells: int
    elapsed_s: float
    channels: tuple[ChannelProgress, ...]
    faults: int
    latest_fault: Fault | None
    hint: str
    state: SessionState = SessionState.IDLE
    armed_s: float | None = None
