"""What is in a recording and how well it is, found in one walk that holds no readings.

What to think of it is for `recordings.health`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from recordings import codec
from recordings.definitions import Definitions
from recordings.errors import RecordingError, RigError
from recordings.events import (
    ClockSample,
    Dwell,
    Fault,
    LedgerEntry,
    Mark,
    RoundTrip,
    StateChange,
)
from recordings.joining import next_path
from recordings.part_file import RIG_ATTACHMENT
from recordings.rig import Rig, parse_rig
from recordings.session import Session
from recordings.survey_walk import RECOVERY_METADATA, File, Walk
from recordings.tally import ReadingTally, Tally


@dataclass(frozen=True, slots=True)
class Survey:
    """A recording at a glance.

    Attributes:
        files: its files, in order.
        missing_part: why a further part could not be read, or "".
        rig_toml, rig: its rig description; None where it is lost. ``rig`` is also None where the
            description is not valid, and ``rig_error`` says why.
        session: who recorded it.
        recovery: what a recovery noted, where it was recovered; else empty.
        metadata, attachments: all there are, by name; the first of each name, and of metadata the
            first that can be read, where one can.
        definitions: its schemas and channels.
        topics: sums by topic, in order of first appearance.
        readings: sums by channel of the rig, in the order of first appearance.
        dwells, marks, faults, states, clock, round_trips: events in file order.
        ledger: last entry of each source.
        undeclared: messages whose channel is not known.
        other: messages of topics that are not part of the format.
    """

    files: tuple[File, ...]
    missing_part: str
    rig_toml: str | None
    rig: Rig | None
    rig_error: str
    session: Session
    recovery: Mapping[str, str]
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, bytes]
    definitions: Definitions
    topics: Mapping[str, Tally]
    readings: Mapping[str, ReadingTally]
    dwells: tuple[Dwell, ...]
    marks: tuple[Mark, ...]
    faults: tuple[Fault, ...]
    states: tuple[StateChange, ...]
    clock: tuple[ClockSample, ...]
    round_trips: tuple[RoundTrip, ...]
    ledger: Mapping[str, LedgerEntry]
    undeclared: int
    other: int

    @property
    def damage(self) -> tuple[str, ...]:
        """What is wrong with the files, a line each; empty for a whole recording."""
        several = len(self.files) > 1
        lines = [
            f"{file.path.name}, {line}" if several else str(line)
            for file in self.files
            for line in file.damage
        ]
        return (*lines, self.missing_part) if self.missing_part else tuple(lines)

    @property
    def hopeless(self) -> str:
        """Why nothing of it can be used, or ""."""
        if self.rig_toml is None:
            return "the rig description is lost, everywhere it stood"
        if self.damage and not self.has_messages:
            return "no message of it can be read"
        return ""

    @property
    def has_messages(self) -> bool:
        """Whether any message can be read."""
        return any(tally.count for tally in self.topics.values())

    @property
    def start_ns(self) -> int:
        """Time of the earliest message; 0 in a recording without any."""
        return min((tally.first_ns for tally in self.topics.values() if tally.count), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the latest message; 0 in a recording without any."""
        return max((tally.last_ns for tally in self.topics.values() if tally.count), default=0)

    def channel(self, name: str) -> Tally:
        """Sums over the readings of a channel of the rig."""
        return self.topics.get(codec.READING.topic(name), Tally())


def survey(path: str | Path, on_progress: Callable[[float], None] = lambda share: None) -> Survey:
    """Walk through a recording, all its parts if ``path`` is the first of them.

    Args:
        path: the file.
        on_progress: takes the share of the current file that was walked through, 0 to 1.

    Raises:
        NothingReadable: the file is empty, or no MCAP file and nothing like one.
        NotARecording: no such file, no file at all, or a sound MCAP file of another kind.
        RecordingError: the disk failed, or the file may not be read.
    """
    first = Path(path)
    walk = Walk(on_progress)
    walk.take(first)
    missing = ""
    while walk.files[0].part.number == 1 and walk.files[-1].part.next_file:
        number = len(walk.files) + 1
        found = next_path(first, number, walk.files[-1].part.next_file)
        try:
            walk.take(found)
        except RecordingError as error:
            missing = f"part {number} and what may follow it is missing: {error}"
            break
    return _surveyed(walk, missing)


def _surveyed(walk: Walk, missing_part: str) -> Survey:
    ledger = {e.source: e for e in walk.events if isinstance(e, LedgerEntry)}
    if walk.is_own():
        for name, entry in ledger.items():
            tally = walk.topics.get(codec.READING.topic(name))
            if tally is not None:
                tally.end(entry.received)
    data = walk.attachments.get(RIG_ATTACHMENT)
    rig, rig_error, rig_toml = None, "", None
    if data is not None:
        rig_toml = data.decode("utf-8", "replace")
        try:
            rig = parse_rig(rig_toml, "the rig description that it carries")
        except RigError as error:
            rig_error = str(error)
    return Survey(
        files=tuple(walk.files),
        missing_part=missing_part,
        rig_toml=rig_toml,
        rig=rig,
        rig_error=rig_error,
        session=walk.session or Session(software=""),
        recovery=walk.metadata.get(RECOVERY_METADATA, {}),
        metadata={**walk.unreadable_metadata, **walk.metadata},
        attachments=walk.attachments,
        definitions=walk.definitions,
        topics=walk.topics,
        readings=walk.readings,
        dwells=tuple(e for e in walk.events if isinstance(e, Dwell)),
        marks=tuple(e for e in walk.events if isinstance(e, Mark)),
        faults=tuple(e for e in walk.events if isinstance(e, Fault)),
        states=tuple(e for e in walk.events if isinstance(e, StateChange)),
        clock=tuple(e for e in walk.events if isinstance(e, ClockSample)),
        round_trips=tuple(e for e in walk.events if isinstance(e, RoundTrip)),
        ledger=ledger,
        undeclared=walk.undeclared,
        other=walk.other,
    )
