"""Blocks of a file -> readings by channel and events: what a recording is put together from.

Owns the meaning of topics on the reading side. Blocks are decoded in windows of a few MiB,
so that the work an array needs is shared by many small chunks; what stays in memory is the
decoded columns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings import codec, columns, records
from recordings.chunks import CHANNEL, SCHEMA, Block, Damage
from recordings.errors import NotARecording
from recordings.events import Event
from recordings.recording import Readings
from recordings.wire import FIELDS

WINDOW_BYTES = 4 * 1024 * 1024
"""Uncompressed bytes that are decoded at a time."""

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
        self._window: list[tuple[Block, NDArray[np.int64]]] = []
        self._window_bytes = 0
        self._parts: dict[str, list[dict[str, NDArray[Any]]]] = {}

    def add(self, block: Block) -> None:
        """Take the records of one block.

        Raises:
            NotARecording: a topic of the format carries something else.
        """
        offsets, end = columns.record_offsets(block.data)
        if end < len(block.data):
            self.damage.append(Damage(block.offset, "a block that ends inside a record"))
        opcodes = np.frombuffer(block.data, np.uint8)[offsets]
        for at in offsets[(opcodes == SCHEMA) | (opcodes == CHANNEL)].tolist():
            self._define(block, at)
        self._window.append((block, offsets))
        self._window_bytes += len(block.data)
        if self._window_bytes >= WINDOW_BYTES:
            self._decode()

    def finish(self) -> None:
        """Decode what is still waiting; call it after the last block."""
        self._decode()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that have readings."""
        return tuple(self._parts)

    def readings(self, channel: str) -> Readings:
        """All readings of ``channel``, which are forgotten here."""
        parts = self._parts.pop(channel, [])
        joined = {
            name: np.concatenate([np.empty(0, kind), *(part.pop(name) for part in parts)])
            for name, kind in _COLUMN_TYPES.items()
        }
        time_ns = joined["time_ns"]
        if np.any(time_ns[1:] < time_ns[:-1]):
            order = np.argsort(time_ns, kind="stable")
            joined = {name: column[order] for name, column in joined.items()}
        for column in joined.values():
            column.flags.writeable = False
        complete = {name: bool(len(time_ns) and joined[f"has_{name}"].all()) for name in _OPTIONAL}
        return Readings(
            channel=channel,
            time_ns=joined["time_ns"],
            raw=joined["raw"],
            device_time_ns=joined["device_time_ns"] if complete["device_time_ns"] else None,
            sequence=joined["sequence"] if complete["sequence"] else None,
            flags=joined["flags"],
        )

    def _define(self, block: Block, at: int) -> None:
        end = at + 9 + int.from_bytes(block.data[at + 1 : at + 9], "little")
        content = block.data[at + 9 : end]
        if block.data[at:end] in self._defined:
            return
        self._defined.add(block.data[at:end])
        try:
            if block.data[at] == SCHEMA:
                schema = records.parse_schema(content)
                known: object = self._schemas.setdefault(schema.id, schema)
                same = known == schema
            else:
                channel = records.parse_channel(content)
                known = self._channels.setdefault(channel.id, channel)
                same = known == channel
        except records.Malformed as error:
            self.damage.append(Damage(block.offset, str(error)))
            return
        if not same:
            self.damage.append(Damage(block.offset, f"a second definition of {known}"))
        elif block.data[at] == CHANNEL:
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

    def _decode(self) -> None:
        """Decode the window and empty it."""
        if not self._window:
            return
        first = self._window[0][0].offset
        offsets, base = [], 0
        for block, places in self._window:
            offsets.append(places + base)
            base += len(block.data)
        found = columns.messages(
            b"".join(block.data for block, _ in self._window), np.concatenate(offsets)
        )
        self._window.clear()
        self._window_bytes = 0
        sorts = self._sorts[found.channel_id]
        sound = (found.time_ns >= 0) & (sorts != _UNDECLARED)
        if not sound.all():
            text = f"{np.sum(~sound)} messages of undeclared channels or impossible times"
            self.damage.append(Damage(first, text))
        self._decode_readings(found.take(sound & (sorts == _READING)), first)
        self._decode_events(found.take(sound & (sorts == _EVENT)), first)

    def _decode_readings(self, found: columns.Messages, first: int) -> None:
        decoded = columns.decode_readings(found)
        if not decoded.readable.all():
            text = f"{np.sum(~decoded.readable)} readings that cannot be read, or have no 'raw'"
            self.damage.append(Damage(first, text))
        table = {"time_ns": found.time_ns, **decoded.values}
        table |= {f"has_{name}": decoded.present[name] for name in _OPTIONAL}
        for channel_id in np.unique(found.channel_id).tolist():
            rows = np.flatnonzero((found.channel_id == channel_id) & decoded.readable)
            _, subject = self._topics[channel_id]
            part = {name: column[rows] for name, column in table.items()}
            self._parts.setdefault(subject, []).append(part)

    def _decode_events(self, found: columns.Messages, first: int) -> None:
        for row in range(len(found.start)):
            kind, subject = self._topics[int(found.channel_id[row])]
            time_ns = int(found.time_ns[row])
            try:
                self.events.append(codec.decode(kind, subject, time_ns, found.payload(row)))
            except ValueError as error:
                self.damage.append(Damage(first, str(error)))


_OPTIONAL = ("device_time_ns", "sequence")
_COLUMN_TYPES = {
    "time_ns": "<i8",
    **{name: kind for name, _, kind in FIELDS},
    **{f"has_{name}": "?" for name in _OPTIONAL},
}
