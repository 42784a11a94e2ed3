"""The walk through the files of a recording: what each holds, counted and not kept.

Owns which file belongs to a recording, the rig, session and events as far as they can be
read, and the sums over every topic. Holds one window of a file at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recordings import codec, columns
from recordings.definitions import Definitions
from recordings.errors import NotARecording
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
from recordings.items import Attachment, Block, Damage, Header, Metadata
from recordings.part import FIRST_PART, Part, belongs, one_byte_off
from recordings.part_file import PROFILE
from recordings.session import METADATA_NAME, Session, from_metadata
from recordings.source import opened
from recordings.tally import ReadingTally, Tally
from recordings.window import Records, Window

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


class Walk:
    """What was found so far, in all files.

    Attributes:
        files: the files walked through.
        metadata, attachments: by name, the first of each; of metadata the first that can be read.
        unreadable_metadata: by name, the first of each that says something impossible.
        session: who recorded it, or None where that is lost.
        definitions: schemas and channels.
        topics: sums by topic.
        readings: sums by channel of the rig.
        events: dwells, marks and the like, in file order; of a ledger the last entries.
        undeclared: messages whose channel is not known.
        other: messages of topics that are not part of the format.
    """

    def __init__(self, on_progress: Callable[[float], None]) -> None:
        self.files: list[File] = []
        self._on_progress = on_progress
        self.metadata: dict[str, Mapping[str, str]] = {}
        self.unreadable_metadata: dict[str, Mapping[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.session: Session | None = None
        self._part = FIRST_PART
        self._library = ""
        self._session_id = ""
        self._checked = False
        self._window = Window()
        self.definitions = Definitions()
        self.topics: dict[str, Tally] = {}
        self.readings: dict[str, ReadingTally] = {}
        self.events: list[Event] = []
        self.undeclared = 0
        self.other = 0

    def take(self, path: Path) -> None:
        """Walk through one file, the first or the part behind the last; raises as `survey` does."""
        damage: list[Damage] = []
        self._part, self._library, self._checked = FIRST_PART, "", False
        with opened(path) as source:
            closed = source.is_closed()
            for item in source.items():
                damage += self._take(path, item)
                self._on_progress(source.share)
            damage += self._count(path, self._window.rest())
        self.files.append(
            File(
                path=path,
                size=source.size,
                part=self._part,
                closed=closed,
                library=self._library,
                damage=tuple(sorted(damage, key=lambda each: each.offset)),
            )
        )

    def is_own(self) -> bool:
        """Whether this program wrote the file: its sequence numbers then count from 0."""
        recovered = self.metadata.get(RECOVERY_METADATA, {}).get("library", "")
        software = "" if self.session is None else self.session.software
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
                self.attachments.setdefault(name, data)
            case Metadata(name, pairs):
                return self._describe(name, pairs)
            case Block():
                return self._count(path, self._window.add(item))
            case Damage():
                return [item]
        return []

    def _describe(self, name: str, pairs: dict[str, str]) -> list[Damage]:
        try:
            self._part = self._part.with_metadata(name, pairs)
            session = from_metadata(pairs) if name == METADATA_NAME else None
        except ValueError as error:
            self.unreadable_metadata.setdefault(name, pairs)
            return [Damage(0, f"metadata '{name}': {error}")]
        self.metadata.setdefault(name, pairs)
        if session is None:
            return []
        self._session_id = session.session_id
        self.session = self.session or session
        if session == self.session:
            return []
        text = "it stands there twice, and not alike; the first counts"
        return [Damage(0, f"metadata '{name}': {text}")]

    def _check_part(self, path: Path) -> None:
        """Before any message of a later file is counted: is it the part that comes next?"""
        if self._checked or not self.files or self.session is None:
            return
        self._checked = True
        before = self.files[-1]
        stranger = belongs(
            self._part,
            self._session_id,
            number=before.part.number + 1,
            session_id=self.session.session_id,
            previous_file=before.path.name,
        )
        if stranger:
            raise NotARecording(f"'{path}' {stranger}")

    def _count(self, path: Path, taken: Records | None) -> list[Damage]:
        if taken is None:
            return []
        self._check_part(path)
        wrong = self.definitions.take(taken.data, taken.offsets)
        damage = [*taken.damage, *(Damage(taken.offset, text) for text in wrong)]
        found, channels = columns.messages(taken.data, taken.offsets).by_channel()
        for channel_id, rows in channels:
            own = found.take(rows)
            time_ns = own.time_ns()
            if np.any(time_ns < 0):
                own = own.take(time_ns >= 0)
                time_ns = own.time_ns()
            channel = self.definitions.channels.get(channel_id)
            if channel is None:
                self.undeclared += len(own)
                text = f"{len(own)} messages of channel {channel_id}, which is not defined"
                damage.append(Damage(taken.offset, text))
                continue
            self._tally(channel.topic).add(time_ns, own.sequence())
            topic = codec.kind_of_topic(channel.topic)
            if topic is None:
                self.other += len(own)
            else:
                damage += self._look(*topic, own, taken.offset)
        return damage

    def _tally(self, topic: str) -> Tally:
        tally = self.topics.get(topic)
        if tally is None:
            tally = self.topics[topic] = Tally()
            first = self.files[0].part if self.files else self._part
            if self.is_own():
                kind_and_subject = codec.kind_of_topic(topic)
                before = first.received_before
                if first.number == 1:
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
            tally = self.readings.setdefault(subject, ReadingTally())
            tally.unreadable += unreadable
            tally.add(decoded)
            text = f"{unreadable} readings that cannot be read, or have no 'raw'"
            return [Damage(offset, text)] if unreadable else []
        if kind.event not in _KEPT:
            return []
        wrong = []
        # Of a ledger only the last entry counts.
        first = max(0, len(found) - 1) if kind.event is LedgerEntry else 0
        time_ns = found.time_ns().tolist()
        for row in range(first, len(found)):
            try:
                self.events.append(codec.decode(kind, subject, time_ns[row], found.payload(row)))
            except ValueError as error:
                wrong.append(Damage(offset, str(error)))
        return wrong
