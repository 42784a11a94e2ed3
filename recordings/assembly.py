"""Blocks of a file -> readings by channel and events: what a recording is put together from.

Owns the meaning of topics on the reading side. Blocks are decoded in windows, so that the
work an array needs is shared by many small chunks; what stays in memory is the decoded
columns.
"""

from __future__ import annotations

import numpy as np

from recordings import codec, columns, records
from recordings.chunks import CHANNEL, SCHEMA, Block, Damage
from recordings.errors import NotARecording
from recordings.events import Event
from recordings.gathering import Gathered
from recordings.recording import Readings
from recordings.window import Records, Window

_UNDECLARED, _FOREIGN, _EVENT, _READING = range(4)


class Assembly:
    """Takes blocks in file order; holds readings and events."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.damage: list[Damage] = []
        self._defined: set[bytes] = set()
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._topics: dict[int, tuple[codec.Kind, str]] = {}
        self._sorts = np.zeros(2**16, np.uint8)
        self._window = Window()
        self._gathered: dict[str, Gathered] = {}

    def add(self, block: Block) -> None:
        """Take the records of one block.

        Raises:
            NotARecording: a topic of the format carries something else.
        """
        self._decode(self._window.add(block))

    def finish(self) -> None:
        """Decode what is still waiting; call it after the last block.

        Raises:
            NotARecording: a topic of the format carries something else.
        """
        self._decode(self._window.rest())

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

    def _decode(self, taken: Records | None) -> None:
        if taken is None:
            return
        first, data, offsets = taken.offset, taken.data, taken.offsets
        self.damage += taken.damage
        opcodes = np.frombuffer(data, np.uint8)[offsets]
        for at in offsets[(opcodes == SCHEMA) | (opcodes == CHANNEL)].tolist():
            self._define(data, at, first)
        found = columns.messages(data, offsets)
        lost = unreadable = 0
        events: list[tuple[int, int, int, int]] = []
        for channel_id, own in found.by_channel():
            sort = self._sorts[channel_id]
            if sort == _UNDECLARED:
                lost += len(own)
                continue
            if np.any(own.time_ns < 0):
                lost += int(np.sum(own.time_ns < 0))
                own = own.take(own.time_ns >= 0)
            if sort == _READING:
                _, subject = self._topics[channel_id]
                part, wrong = columns.decode_readings(own)
                unreadable += wrong
                self._gathered.setdefault(subject, Gathered()).append(part)
            elif sort == _EVENT:
                where = (own.start, own.start + own.size, own.channel_id, own.time_ns)
                events += zip(*(column.tolist() for column in where), strict=True)
        if lost:
            text = f"{lost} messages of undeclared channels or impossible times"
            self.damage.append(Damage(first, text))
        if unreadable:
            text = f"{unreadable} readings that cannot be read, or have no 'raw'"
            self.damage.append(Damage(first, text))
        self._decode_events(data, sorted(events), first)

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
