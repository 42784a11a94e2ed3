"""An MCAP file being written: header, chunks with indexes and CRCs, summary.

The container of a recording, without what is in it. It writes the records of the mcap
library, but builds chunks itself, because the library takes one message at a time and a
chunk of readings is one array here. Each chunk names the channels it holds again, so that
it can be read even where chunks before it are lost.
"""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO

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

from recordings.wire import MESSAGE_OPCODE

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 64 * 1024
"""Uncompressed size at which a chunk is closed: small, because a crash takes the open one."""

_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX_ENTRY = struct.Struct("<QQ")
_INDEX_ROW = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class Container:
    """Writes MCAP records to a binary stream. One thread at a time."""

    def __init__(self, stream: BinaryIO, profile: str, library: str) -> None:
        self._stream = stream
        self._position = 0
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
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

    def register_schema(self, name: str, data: bytes) -> int:
        """Register a protobuf schema; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding="protobuf", name=name)
        self._schemas.append(schema)
        self._new_schemas.append(schema)
        return schema.id

    def register_channel(self, topic: str, schema_id: int) -> int:
        """Register a topic of protobuf messages; returns its channel id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="protobuf",
            metadata={},
            schema_id=schema_id,
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        return channel.id

    def count(self, channel_id: int) -> int:
        """Messages written to a channel so far: the MCAP sequence of its next one."""
        return self._counts[channel_id]

    def add(self, channel_id: int, time_ns: int, payload: bytes) -> None:
        """Write one message.

        Raises:
            struct.error: ``time_ns`` is negative or above 64 bits.
        """
        counter = self._counts[channel_id]
        head = _MESSAGE.pack(
            MESSAGE_OPCODE, len(payload) + 22, channel_id, counter % 2**32, time_ns, time_ns
        )
        index = self._index_of(channel_id)
        index += _INDEX_ENTRY.pack(time_ns, len(self._chunk))
        self._chunk += head
        self._chunk += payload
        self._counts[channel_id] = counter + 1
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
            self._counts[channel_id] += len(now)
            self._span(int(now["log_time"].min()), int(now["log_time"].max()))
            if len(self._chunk) >= CHUNK_BYTES:
                self.end_chunk()

    def end_chunk(self) -> None:
        """Close the open chunk, if it holds messages, and hand everything to the system."""
        if self._indexes:
            self._write_chunk()
            self._begin_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the last chunk and the summary. The stream stays open."""
        self.end_chunk()
        self._put(_bytes(DataEnd(data_section_crc=self._crc)))
        self._write_summary()
        self._stream.flush()

    def _put(self, data: bytes) -> int:
        self._stream.write(data)
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
            self._chunk += _bytes(self._channels[channel_id - 1])
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
        length = self._put(_bytes(chunk))
        index_start = self._position
        offsets: dict[int, int] = {}
        for channel_id, entries in self._indexes.items():
            offsets[channel_id] = self._position
            head = struct.pack(
                "<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), channel_id, len(entries)
            )
            self._put(head + bytes(entries))
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=self._chunk_last_ns,
                message_index_length=self._position - index_start,
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
            channel_message_counts={key: count for key, count in self._counts.items() if count},
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _write_summary(self) -> None:
        start = self._position
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
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
        self._put(bytes(summary) + _bytes(footer) + MAGIC)


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
