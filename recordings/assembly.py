"""Blocks of a file -> readings by channel and events: what a recording is put together from.

Owns the meaning of topics on the reading side. Blocks are decoded in windows, so that the
work an array needs is shared by many small chunks; what stays in memory is the decoded
columns.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np

from recordings import codec, columns, records
from recordings.errors import NotARecording
from recordings.events import Event, LedgerEntry
from recordings.gathering import Gathered
from recordings.items import Block, Damage
from recordings.recording import Readings
from recordings.records import CHANNEL, SCHEMA
from recordings.window import Records, Window

_UNDECLARED, _FOREIGN, _EVENT, _READING = range(4)


class Assembly:
    """Takes blocks in file order; holds readings and events.

    Of a ledger it holds the latest entry of each window only: an entry says all that those
    before it said.
    """

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.damage: list[Damage] = []
        self._defined: set[bytes] = set()
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._topics: dict[int, tuple[codec.Kind, str]] = {}
        self._sorts: dict[int, int] = {}
        self._window = Window()
        self._gathered: dict[str, Gathered] = {}

    def add(self, block: Block) -> None:
        """Take the records of one block.

        Raises:
            NotARecording: a topic of the format carries something else.
        """
        taken = self._window.add(block)
        if taken is not None:
            self._decode(taken)

    def finish(self) -> None:
        """Decode what is still waiting; call it after the last block.

        Raises:
            NotARecording: a topic of the format carries something else.
        """
        taken = self._window.rest()
        if taken is not None:
            self._decode(taken)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that have readings."""
        return tuple(self._gathered)

    def readings(self, channel: str) -> Readings:
        """All readings of ``channel``, which are forgotten here."""
        return self._gathered.pop(channel, Gathered()).readings(channel)

    def _define(self, data: bytes, at: int, offset: int) -> None:
        """Take note of the schema or channel at ``at``; ``offset`` is where it is in the file."""
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at:end] in self._defined:
            return
        self._defined.add(data[at:end])
        content = data[at + 9 : end]
        try:
            if data[at] == SCHEMA:
                schema = records.parse_schema(content)
                known: object = self._schemas.setdefault(schema.id, schema)
                same = known == schema
            else:
                channel = records.parse_channel(content)
                known = self._channels.setdefault(channel.id, channel)
                same = known == channel
        except records.Malformed as error:
            self.damage.append(Damage(offset, str(error)))
            return
        if not same:
            self.damage.append(Damage(offset, f"a second definition of {known}"))
        elif data[at] == CHANNEL:
            self._sort(channel)

    def _sort(self, channel: records.Channel) -> None:
        """Note what kind of messages ``channel`` carries."""
        topic = codec.kind_of_topic(channel.topic)
        if topic is None:
            self._sorts[channel.id] = _FOREIGN
            return
        kind, _ = topic
        schema = self._schemas.get(channel.schema_id)
        name = kind.schema_name if schema is None else schema.name
        if channel.message_encoding != "protobuf" or name != kind.schema_name:
            raise NotARecording(
                f"topic '{channel.topic}' carries '{name}' as '{channel.message_encoding}', "
                f"expected '{kind.schema_name}' as 'protobuf'"
            )
        self._topics[channel.id] = topic
        self._sorts[channel.id] = _READING if kind is codec.READING else _EVENT

    def _decode(self, taken: Records) -> None:
        first, data, offsets = taken.offset, taken.data, taken.offsets
        self.damage += taken.damage
        opcodes = np.frombuffer(data, np.uint8)[offsets]
        for at in offsets[(opcodes == SCHEMA) | (opcodes == CHANNEL)].tolist():
            self._define(data, at, first)
        found, channels = columns.messages(data, offsets).by_channel()
        lost = unreadable = 0
        events: list[tuple[int, int, int, int]] = []
        for sort, group in groupby(channels, lambda each: self._sorts.get(each[0], _UNDECLARED)):
            alike = list(group)
            if sort == _READING:
                early, wrong = self._take_readings(found, alike)
                lost += early
                unreadable += wrong
            elif sort == _EVENT:
                for channel_id, rows in alike:
                    own, early = self._event_rows(channel_id, found.take(rows))
                    events += own
                    lost += early
            elif sort == _UNDECLARED:
                lost += sum(rows.stop - rows.start for _, rows in alike)
        if lost:
            text = f"{lost} messages of undeclared channels or impossible times"
            self.damage.append(Damage(first, text))
        if unreadable:
            text = f"{unreadable} readings that cannot be read, or have no 'raw'"
            self.damage.append(Damage(first, text))
        self._decode_events(data, sorted(events), first)

    def _take_readings(
        self, found: columns.Messages, channels: list[tuple[int, slice]]
    ) -> tuple[int, int]:
        """Decode readings of channels that follow each other.

        Returns:
            How many have impossible times, and how many cannot be read.
        """
        first, behind = channels[0][1].start, channels[-1][1].stop
        alike = columns.decode_alike(found.take(slice(first, behind)))
        lost = unreadable = 0
        for channel_id, rows in channels:
            if alike is not None:
                part = alike.take(slice(rows.start - first, rows.stop - first))
            else:
                part, wrong = columns.decode_readings(found.take(rows))
                unreadable += wrong
            early = part.time_ns < 0
            if early.any():
                lost += int(early.sum())
                part = part.take(~early)
            _, subject = self._topics[channel_id]
            self._gathered.setdefault(subject, Gathered()).append(part)
        return lost, unreadable

    def _event_rows(
        self, channel_id: int, own: columns.Messages
    ) -> tuple[list[tuple[int, int, int, int]], int]:
        """Start, end, channel and time of the events of a channel, and how many have impossible times."""
        time_ns = own.time_ns()
        kept = np.flatnonzero(time_ns >= 0)
        early = len(own) - len(kept)
        if len(kept) and self._topics[channel_id][0].event is LedgerEntry:
            kept = kept[len(kept) - 1 - np.argmax(time_ns[kept][::-1], keepdims=True)]
        start, size = own.start[kept], own.size[kept]
        where = (start, start + size, np.full(len(kept), channel_id), time_ns[kept])
        return list(zip(*(column.tolist() for column in where), strict=True)), early

    def _decode_events(
        self, data: bytes, rows: list[tuple[int, int, int, int]], first: int
    ) -> None:
        """Decode events given as start, end, channel and time, in file order."""
        for start, end, channel_id, time_ns in rows:
            kind, subject = self._topics[channel_id]
            try:
                self.events.append(codec.decode(kind, subject, time_ns, data[start:end]))
            except ValueError as error:
                self.damage.append(Damage(first, str(error)))
