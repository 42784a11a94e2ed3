"""What is in a recording and how well it is, found in one walk that holds no readings.

Owns the walk over all parts, the rig and session as far as they can be read, the events,
and the sums over every topic. What to think of it is for `recordings.health`.
"""

from __future__ import annotations

import stat
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recordings import codec, columns
from recordings.chunks import Attachment, Block, Damage, Header, Metadata, scan
from recordings.container import MAGIC
from recordings.definitions import Definitions
from recordings.errors import NotARecording, NothingReadable, RecordingError, RigError
from recordings.events import (
    ClockSample,
    Dwell,
    Event,
    Fault,
    LedgerEntry,
    Mark,
    RoundTrip,
    StateChange,
)
from recordings.joining import next_path
from recordings.part import FIRST_PART, Part
from recordings.part_file import PROFILE, RIG_ATTACHMENT
from recordings.reader import one_byte_off
from recordings.records import Malformed
from recordings.rig import Rig, parse_rig
from recordings.session import METADATA_NAME, Session, from_metadata
from recordings.tally import ReadingTally, Tally
from recordings.window import Records, Window
from recordings.wire import HEADER_SIZE, unaligned

RECOVERY_METADATA = "loopcal.recovery"
"""Metadata record of a recording that was recovered from a damaged one."""

_KEPT = (Dwell, Mark, Fault, StateChange, ClockSample, RoundTrip, LedgerEntry)


@dataclass(frozen=True, slots=True)
class File:
    """One file of a recording.

    Attributes:
        path: where it is.
        size: bytes.
        part: which part it is.
        closed: whether it ends as a closed file does.
        library: the program that wrote it.
        damage: what is wrong with it.
    """

    path: Path
    size: int
    part: Part
    closed: bool
    library: str
    damage: tuple[Damage, ...]


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
        metadata, attachments: all there are, by name; the first of each name.
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
    walk = _Walk(on_progress)
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
    return walk.survey(missing)


class _Walk:
    """What was found so far."""

    def __init__(self, on_progress: Callable[[float], None]) -> None:
        self.files: list[File] = []
        self._on_progress = on_progress
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._attachments: dict[str, bytes] = {}
        self._session: Session | None = None
        self._part = FIRST_PART
        self._library = ""
        self._window = Window()
        self._definitions = Definitions()
        self._topics: dict[str, Tally] = {}
        self._readings: dict[str, ReadingTally] = {}
        self._events: list[Event] = []
        self._undeclared = 0
        self._other = 0

    def take(self, path: Path) -> None:
        """Walk through one file; raises as `survey` does."""
        damage: list[Damage] = []
        self._part, self._library = FIRST_PART, ""
        try:
            status = path.stat()
            if not stat.S_ISREG(status.st_mode):
                raise NotARecording(f"'{path}' is not a file; expected a recording (MCAP)")
            with path.open("rb") as file:
                file.seek(max(0, status.st_size - len(MAGIC)))
                closed = file.read(len(MAGIC)) == MAGIC and status.st_size > 2 * len(MAGIC)
                for item in scan(file, status.st_size):
                    damage += self._take(path, item)
                    self._on_progress(file.tell() / max(1, status.st_size))
                damage += self._count(self._window.rest())
        except FileNotFoundError as error:
            raise NotARecording(f"there is no file '{path}'") from error
        except Malformed as error:
            what = "is empty" if status.st_size == 0 else f"is not an MCAP file: {error}"
            raise NothingReadable(f"'{path}' {what}; nothing of a recording is in it") from error
        except OSError as error:
            raise RecordingError(f"cannot read '{path}': {error}") from error
        number = self._part.number
        if self.files and number != len(self.files) + 1:
            raise NotARecording(f"'{path}' is part {number}, expected part {len(self.files) + 1}")
        self.files.append(
            File(
                path=path,
                size=status.st_size,
                part=self._part,
                closed=closed,
                library=self._library,
                damage=tuple(sorted(damage, key=lambda each: each.offset)),
            )
        )

    def survey(self, missing_part: str) -> Survey:
        ledger = {e.source: e for e in self._events if isinstance(e, LedgerEntry)}
        if self._is_own():
            for name, entry in ledger.items():
                tally = self._topics.get(codec.READING.topic(name))
                if tally is not None:
                    tally.end(entry.received)
        data = self._attachments.get(RIG_ATTACHMENT)
        rig, rig_error, rig_toml = None, "", None
        if data is not None:
            rig_toml = data.decode("utf-8", "replace")
            try:
                rig = parse_rig(rig_toml, "the rig description that it carries")
            except RigError as error:
                rig_error = str(error)
        return Survey(
            files=tuple(self.files),
            missing_part=missing_part,
            rig_toml=rig_toml,
            rig=rig,
            rig_error=rig_error,
            session=self._session or Session(software=""),
            recovery=self._metadata.get(RECOVERY_METADATA, {}),
            metadata=self._metadata,
            attachments=self._attachments,
            definitions=self._definitions,
            topics=self._topics,
            readings=self._readings,
            dwells=tuple(e for e in self._events if isinstance(e, Dwell)),
            marks=tuple(e for e in self._events if isinstance(e, Mark)),
            faults=tuple(e for e in self._events if isinstance(e, Fault)),
            states=tuple(e for e in self._events if isinstance(e, StateChange)),
            clock=tuple(e for e in self._events if isinstance(e, ClockSample)),
            round_trips=tuple(e for e in self._events if isinstance(e, RoundTrip)),
            ledger=ledger,
            undeclared=self._undeclared,
            other=self._other,
        )

    def _is_own(self) -> bool:
        """Whether this program wrote the file: its sequence numbers then count from 0."""
        recovered = self._metadata.get(RECOVERY_METADATA, {}).get("library", "")
        software = "" if self._session is None else self._session.software
        return any(x.startswith("loopcal ") for x in (recovered or self._library, software))

    def _take(self, path: Path, item: object) -> list[Damage]:
        """Take one item; returns what is wrong with it."""
        match item:
            case Header(profile, library):
                self._library = library
                if profile == PROFILE:
                    return []
                if one_byte_off(profile, PROFILE):
                    return [Damage(0, f"a header of profile '{profile}'")]
                raise NotARecording(
                    f"'{path}' is an MCAP file of profile '{profile}' (written by '{library}'), "
                    f"expected profile '{PROFILE}'"
                )
            case Attachment(name, data):
                self._attachments.setdefault(name, data)
            case Metadata(name, pairs):
                return self._describe(name, pairs)
            case Block():
                return self._count(self._window.add(item))
            case Damage():
                return [item]
        return []

    def _describe(self, name: str, pairs: dict[str, str]) -> list[Damage]:
        self._metadata.setdefault(name, pairs)
        try:
            self._part = self._part.with_metadata(name, pairs)
            if name == METADATA_NAME:
                session = from_metadata(pairs)
                self._session = self._session or session
                if session != self._session:
                    raise ValueError("it stands there twice, and not alike; the first counts")
        except ValueError as error:
            return [Damage(0, f"metadata '{name}': {error}")]
        return []

    def _count(self, taken: Records | None) -> list[Damage]:
        if taken is None:
            return []
        wrong = self._definitions.take(taken.data, taken.offsets)
        damage = [*taken.damage, *(Damage(taken.offset, text) for text in wrong)]
        found = columns.messages(taken.data, taken.offsets)
        sequence = unaligned(taken.data, "<u4", 11)[found.start - HEADER_SIZE]
        for channel_id in np.unique(found.channel_id).tolist():
            rows = np.flatnonzero((found.channel_id == channel_id) & (found.time_ns >= 0))
            channel = self._definitions.channels.get(channel_id)
            if channel is None:
                self._undeclared += len(rows)
                text = f"{len(rows)} messages of channel {channel_id}, which is not defined"
                damage.append(Damage(taken.offset, text))
                continue
            tally = self._tally(channel.topic)
            tally.add(found.time_ns[rows], sequence[rows])
            topic = codec.kind_of_topic(channel.topic)
            if topic is None:
                self._other += len(rows)
            else:
                damage += self._look(*topic, found.take(rows), taken.offset)
        return damage

    def _tally(self, topic: str) -> Tally:
        tally = self._topics.get(topic)
        if tally is None:
            tally = self._topics[topic] = Tally()
            if self._is_own() and not self.files:
                kind_and_subject = codec.kind_of_topic(topic)
                before = self._part.received_before
                if self._part.number == 1:
                    tally.next = 0
                elif kind_and_subject is not None and kind_and_subject[0] is codec.READING:
                    tally.next = before.get(kind_and_subject[1], 0)
        return tally

    def _look(
        self, kind: codec.Kind, subject: str, found: columns.Messages, offset: int
    ) -> list[Damage]:
        """Take what messages of one topic say; returns what is wrong with them."""
        if kind is codec.READING:
            decoded, unreadable = columns.decode_readings(found)
            tally = self._readings.setdefault(subject, ReadingTally())
            tally.unreadable += unreadable
            tally.add(decoded)
            text = f"{unreadable} readings that cannot be read, or have no 'raw'"
            return [Damage(offset, text)] if unreadable else []
        if kind.event not in _KEPT:
            return []
        wrong = []
        # Of a ledger only the last entry counts.
        first = len(found.start) - 1 if kind.event is LedgerEntry else 0
        for row in range(first, len(found.start)):
            try:
                time_ns = int(found.time_ns[row])
                self._events.append(codec.decode(kind, subject, time_ns, found.payload(row)))
            except ValueError as error:
                wrong.append(Damage(offset, str(error)))
        return wrong
