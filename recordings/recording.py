"""A recording in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.events import (
    ClockSample,
    Dwell,
    Fault,
    LedgerEntry,
    Mark,
    ModeCommand,
    ModeReport,
    RoundTrip,
    StateChange,
)
from recordings.part import FIRST_PART, Part
from recordings.rig import Rig
from recordings.session import Session


@dataclass(frozen=True, slots=True)
class Readings:
    """All readings of one channel in order of time; read-only arrays of equal length n.

    Attributes:
        channel: channel name of the rig.
        time_ns: (n,) host arrival, nanoseconds since the Unix epoch, never falling.
        raw: (n,) counts.
        device_time_ns: (n,) on the device's clock, or None where any reading lacks it.
        sequence: (n,) device's sample counter, or None where any reading lacks it.
        flags: (n,) `ReadingFlag` bits.
    """

    channel: str
    time_ns: NDArray[np.int64]
    raw: NDArray[np.int64]
    device_time_ns: NDArray[np.int64] | None
    sequence: NDArray[np.uint32] | None
    flags: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, slots=True)
class Recording:
    """What a recording holds. Events of a kind are in order of time.

    Attributes:
        path: the file.
        rig: the rig description that it carries.
        rig_toml: that description's text, as it was attached.
        session: who recorded it, when and with what.
        readings: readings of every channel of the rig, in the rig's order; may be empty.
        dwells, marks, faults, mode_commands, mode_reports, clock, states, round_trips: events.
        ledger: last entry of each source.
        damage: what is wrong with the file, a line each; empty for a whole file.
        session_starts_ns: when each session began, where several were joined into one recording;
            empty as read from a file.
        part: which part of a recording in several files it is, as read from one of them.
    """

    path: Path
    rig: Rig
    rig_toml: str
    session: Session
    readings: Mapping[str, Readings]
    dwells: tuple[Dwell, ...]
    marks: tuple[Mark, ...]
    faults: tuple[Fault, ...]
    mode_commands: tuple[ModeCommand, ...]
    mode_reports: tuple[ModeReport, ...]
    clock: tuple[ClockSample, ...]
    ledger: Mapping[str, LedgerEntry]
    damage: tuple[str, ...] = ()
    session_starts_ns: tuple[int, ...] = ()
    states: tuple[StateChange, ...] = ()
    round_trips: tuple[RoundTrip, ...] = ()
    part: Part = FIRST_PART
