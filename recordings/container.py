"""An MCAP file being written: header, chunks with indexes and CRCs, summary.

The container of a recording, without what is in it. It writes the records of the mcap
library, but builds chunks itself, because the library takes one message at a time and a
chunk of readings is one array here. Each chunk names the channels it holds again, so that
it can be read even where chunks before it are lost. A chunk and its index are handed to the
file in one piece: after a write that failed, the file ends behind whole records.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from typing import Protocol

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from recordings.records import MAGIC, MESSAGE

CHUNK_BYTES = 64 * 1024
"""Uncompressed size at which a chunk is closed: small, because a crash takes the open one."""

_INDEX_BYTES = 128  # of one record in the summary, at most, beside what varies

_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX_ENTRY = struct.Struct("<QQ")
_INDEX_ROW = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class Sink(Protocol):
    """Takes all of ``data``, or nothing and raises OSError."""

    def write(self, data: bytes, /) -> object: ...


class Container:
    """Writes MCAP records to a file. One thread at a time."""

    def __init__(self, sink: Sink, profile: str, library: str) -> None:
        self._sink = sink
        self._position = 0
        self._definition_bytes = 0
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._sequences: dict[int, int] = {}
        self._counts: Counter[int] = Counter()
        self._first_ns: int | None = None
        self._last_ns = 0
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._new_schemas: list[Schema] = []
        self._begin_chunk()
        self._put(MAGIC)
        self._put(_bytes(Header(profile=profile, library=library)))

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write an attachment."""
        offset = self._position
        record = Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
        )
        length = self._put(_bytes(record))
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=time_ns,
                create_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_metadata(self, name: str, pairs: dict[str, str]) -> None:
        """Write a metadata record."""
        offset = self._position
        length = self._put(_bytes(Metadata(name=name, metadata=pairs)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def define_schema(self, schema: Schema) -> None:
        """Take a schema, whose id is new here."""
        self._schemas[schema.id] = schema
        self._definition_bytes += len(_bytes(schema))
        self._new_schemas.append(schema)

    def define_channel(self, channel: Channel, sequence: int = 0) -> None:
        """Take a channel, whose id is new here; ``sequence`` is that of its first message."""
        self._channels[channel.id] = channel
        self._definition_bytes += len(_bytes(channel))
        self._sequences[channel.id] = sequence

    def register_schema(self, name: str, data: bytes) -> int:
        """Register a protobuf schema; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding="protobuf", name=name)
        self.define_schema(schema)
        return schema.id

    def register_channel(self, topic: str, schema_id: int, sequence: int = 0) -> int:
        """Register a topic of protobuf messages; returns its channel id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="protobuf",
            metadata={},
            schema_id=schema_id,
        )
        self.define_channel(channel, sequence)
        return channel.id

    @property
    def size(self) -> int:
        """Bytes handed to the file so far."""
        return self._position

    @property
    def ending_bytes(self) -> int:
        """Bytes that `finish` writes behind the last chunk, at most."""
        indexes = len(self._chunk_indexes) * (_INDEX_BYTES + 10 * len(self._channels))
        others = len(self._attachments) + len(self._metadata)
        statistics = _INDEX_BYTES + 10 * len(self._channels)
        return self._definition_bytes + indexes + statistics + (others + 4) * _INDEX_BYTES

    def sequence(self, channel_id: int) -> int:
        """The MCAP sequence of a channel's next message."""
        return self._sequences[channel_id]

    def add(self, channel_id: int, time_ns: int, payload: bytes) -> None:
        """Write one message.

        Raises:
            struct.error: ``time_ns`` is negative or above 64 bits.
        """
        sequence = self._sequences[channel_id]
        head = _MESSAGE.pack(
            MESSAGE, len(payload) + 22, channel_id, sequence % 2**32, time_ns, time_ns
        )
        index = self._index_of(channel_id)
        index += _INDEX_ENTRY.pack(time_ns, len(self._chunk))
        self._chunk += head
        self._chunk += payload
        self._sequences[channel_id] = sequence + 1
        self._span(time_ns, time_ns)
        if len(self._chunk) >= CHUNK_BYTES:
            self.end_chunk()

    def add_rows(self, channel_id: int, rows: NDArray[np.void]) -> None:
        """Write many messages of one channel, given as whole Message records."""
        size = rows.dtype.itemsize
        while len(rows):
            index = self._index_of(channel_id)
            fitting = max(1, -(-(CHUNK_BYTES - len(self._chunk)) // size))
            now, rows = rows[:fitting], rows[fitting:]
            entries = np.empty(len(now), _INDEX_ROW)
            entries["log_time"] = now["log_time"]
            entries["offset"] = len(self._chunk) + size * np.arange(len(now))
            index += entries.tobytes()
            self._chunk += now.tobytes()
            self._sequences[channel_id] += len(now)
            self._span(int(now["log_time"].min()), int(now["log_time"].max()))
            if len(self._chunk) >= CHUNK_BYTES:
                self.end_chunk()

    def add_copies(
        self,
        data: bytes,
        start: NDArray[np.int64],
        stop: NDArray[np.int64],
        channel_id: NDArray[np.uint16],
        time_ns: NDArray[np.int64],
    ) -> None:
        """Write Message records of another file as they are; their channels are defined here.

        Args:
            data: the records.
            start, stop: (n,) where each begins and ends in ``data``.
            channel_id: (n,) their channels.
            time_ns: (n,) their log times.
        """
        ends = np.cumsum(stop - start)
        first = 0
        while first < len(start):
            before = int(ends[first - 1]) if first else 0
            last = 1 + int(np.searchsorted(ends, before + CHUNK_BYTES - len(self._chunk)))
            rows = slice(first, max(first + 1, last))
            indexes = {int(each): self._index_of(int(each)) for each in np.unique(channel_id[rows])}
            entries = np.empty(len(start[rows]), _INDEX_ROW)
            entries["log_time"] = time_ns[rows]
            entries["offset"] = len(self._chunk) + ends[rows] - (stop - start)[rows] - before
            for each, index in indexes.items():
                index += entries[channel_id[rows] == each].tobytes()
            self._chunk += b"".join(_runs(data, start[rows], stop[rows]))
            self._span(int(time_ns[rows].min()), int(time_ns[rows].max()))
            first = rows.stop
            if len(self._chunk) >= CHUNK_BYTES:
                self.end_chunk()

    def end_chunk(self) -> None:
        """Close the open chunk, if it holds messages, and hand it to the file."""
        if self._indexes:
            self._write_chunk()
            self._begin_chunk()

    def abandon_chunk(self) -> dict[int, int]:
        """Forget the open chunk; returns how many messages of each channel were in it."""
        lost = {key: len(index) // _INDEX_ENTRY.size for key, index in self._indexes.items()}
        for channel_id, count in lost.items():
            self._sequences[channel_id] -= count
        self._new_schemas = list(self._schemas.values())
        self._begin_chunk()
        return lost

    def finish(self) -> None:
        """Write the last chunk and the summary. The file stays open."""
        self.end_chunk()
        end = _bytes(DataEnd(data_section_crc=self._crc))
        self._put(end + self._summary(self._position + len(end)))

    def _put(self, data: bytes) -> int:
        self._sink.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._position += len(data)
        return len(data)

    def _begin_chunk(self) -> None:
        self._chunk = bytearray()
        self._indexes: dict[int, bytearray] = {}
        self._chunk_first_ns = 2**64
        self._chunk_last_ns = 0

    def _index_of(self, channel_id: int) -> bytearray:
        """Index of a channel in the open chunk; declares the channel at its first message."""
        index = self._indexes.get(channel_id)
        if index is None:
            for schema in self._new_schemas:
                self._chunk += _bytes(schema)
            self._new_schemas.clear()
            self._chunk += _bytes(self._channels[channel_id])
            index = self._indexes[channel_id] = bytearray()
        return index

    def _span(self, first_ns: int, last_ns: int) -> None:
        self._chunk_first_ns = min(self._chunk_first_ns, first_ns)
        self._chunk_last_ns = max(self._chunk_last_ns, last_ns)

    def _write_chunk(self) -> None:
        data = bytes(self._chunk)
        compressed = self._compressor.compress(data)
        chunk = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=self._chunk_first_ns,
            message_end_time=self._chunk_last_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        offset = self._position
        written = bytearray(_bytes(chunk))
        length = len(written)
        offsets: dict[int, int] = {}
        for channel_id, entries in self._indexes.items():
            offsets[channel_id] = offset + len(written)
            written += struct.pack(
                "<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), channel_id, len(entries)
            )
            written += entries
        self._put(bytes(written))
        for channel_id, entries in self._indexes.items():
            self._counts[channel_id] += len(entries) // _INDEX_ENTRY.size
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=self._chunk_last_ns,
                message_index_length=len(written) - length,
                message_index_offsets=offsets,
                message_start_time=self._chunk_first_ns,
                uncompressed_size=len(data),
            )
        )
        first = self._chunk_first_ns
        self._first_ns = first if self._first_ns is None else min(self._first_ns, first)
        self._last_ns = max(self._last_ns, self._chunk_last_ns)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _summary(self, start: int) -> bytes:
        """Summary, footer and magic, which begin at byte ``start``."""
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self._schemas.values()]),
            (Opcode.CHANNEL, [*self._channels.values()]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunk_indexes]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        )
        summary = bytearray()
        offsets = bytearray()
        for opcode, records in groups:
            if records:
                group = b"".join(map(_bytes, records))
                place = SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
                )
                summary += group
                offsets += _bytes(place)
        offsets_start = start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(head, zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc)
        return bytes(summary) + _bytes(footer) + MAGIC


def _runs(data: bytes, start: NDArray[np.int64], stop: NDArray[np.int64]) -> Iterator[bytes]:
    """The pieces of ``data`` from each start to its stop, those that touch in one."""
    breaks = np.flatnonzero(start[1:] != stop[:-1])
    firsts, lasts = [0, *(breaks + 1).tolist()], [*breaks.tolist(), len(start) - 1]
    for first, last in zip(firsts, lasts, strict=True):
        yield data[int(start[first]) : int(stop[last])]


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
