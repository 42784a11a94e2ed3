"""What a session leaves behind: how it ended, what was recorded, and what was lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from recordings.events import Dwell, Fault, LedgerEntry, StateChange
from recordings.timing import DeviceTiming


class Ending(StrEnum):
    """How a session ended."""

    COMPLETE = "complete"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class CaptureSummary:
    """A finished session. The recording is closed and whole, however it ended.

    Attributes:
        path: the recording, the first of its parts where there are several.
        ending: how it ended.
        why: in words, why it stopped or failed; empty when complete.
        duration_s: from the first to the last moment of the recording.
        stops: stops that the plan asked for.
        dwells: dwells recorded, in order.
        ledger: per channel, what should have come, what came, and where the rest went.
        faults: faults in order of arrival, those of stopping included.
        states: every change of the session's state, with its cause.
        timing: what is known of the times of each device in the end.
        error: exception behind a failure, for whoever looks for a bug; or None.
        parts: how many files the recording has.
    """

    path: Path
    ending: Ending
    why: str
    duration_s: float
    stops: int
    dwells: tuple[Dwell, ...]
    ledger: Mapping[str, LedgerEntry]
    faults: tuple[Fault, ...]
    states: tuple[StateChange, ...] = ()
    timing: tuple[DeviceTiming, ...] = ()
    error: BaseException | None = None
    parts: int = 1

    @property
    def poses(self) -> int:
        """Number of different poses among the dwells."""
        return len({dwell.pose for dwell in self.dwells})
