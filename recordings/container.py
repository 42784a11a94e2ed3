"""An MCAP file being written: header, chunks with indexes and CRCs, summary.

The container of a recording, without what is in it. It writes the records of the mcap
library, but builds chunks itself (`recordings.open_chunk`), because the library takes one message
at a time and a chunk of readings is one array here. A chunk and its index are handed to the
file in one piece: after a write that failed, the file ends behind whole records.
"""

from __future__ import annotations

import struct
import zlib
from typing import Protocol

import numpy as np
import zstandard
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)
from numpy.typing import NDArray

from recordings.open_chunk import OpenChunk
from recordings.records import MAGIC, MESSAGE
from recordings.summary import Summary, record_bytes

_MESSAGE = struct.Struct("<BQHIQQ")


class Sink(Protocol):
    """Takes all of ``data``, or nothing and raises OSError."""

    def write(self, data: bytes, /) -> object: ...


class Container:
    """Writes MCAP records to a file. One thread at a time."""

    def __init__(self, sink: Sink, profile: str, library: str) -> None:
        self._sink = sink
        self._position = 0
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor()
        self._sequences: dict[int, int] = {}
        self._summary = Summary()
        self._new_schemas: list[Schema] = []
        self._chunk = OpenChunk()
        self._put(MAGIC)
        self._put(record_bytes(Header(profile=profile, library=library)))

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write an attachment."""
        offset = self._position
        record = Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
        )
        length = self._put(record_bytes(record))
        self._summary.attachments.append(
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
        length = self._put(record_bytes(Metadata(name=name, metadata=pairs)))
        self._summary.metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def define_schema(self, schema: Schema) -> None:
        """Take a schema, whose id is new here."""
        self._summary.define_schema(schema)
        self._new_schemas.append(schema)

    def define_channel(self, channel: Channel, sequence: int = 0) -> None:
        """Take a channel, whose id is new here; ``sequence`` is that of its first message."""
        self._summary.define_channel(channel)
        self._sequences[channel.id] = sequence

    def register_schema(self, name: str, data: bytes) -> int:
        """Register a protobuf schema; returns its id."""
        number = len(self._summary.schemas) + 1
        self.define_schema(Schema(id=number, data=data, encoding="protobuf", name=name))
        return number

    def register_channel(self, topic: str, schema_id: int, sequence: int = 0) -> int:
        """Register a topic of protobuf messages; returns its channel id."""
        channel = Channel(
            id=len(self._summary.channels) + 1,
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
        return self._summary.most_bytes

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
        self._declare(channel_id)
        self._chunk.add(channel_id, time_ns, head + payload)
        self._sequences[channel_id] = sequence + 1
        self._end_full_chunk()

    def add_rows(self, channel_id: int, rows: NDArray[np.void]) -> None:
        """Write many messages of one channel, given as whole Message records."""
        while len(rows):
            self._declare(channel_id)
            taken = self._chunk.add_rows(channel_id, rows)
            self._sequences[channel_id] += taken
            rows = rows[taken:]
            self._end_full_chunk()

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
            last = 1 + int(np.searchsorted(ends, before + self._chunk.room))
            rows = slice(first, max(first + 1, last))
            for each in np.unique(channel_id[rows]).tolist():
                self._declare(each)
            self._chunk.add_copies(data, start[rows], stop[rows], channel_id[rows], time_ns[rows])
            first = rows.stop
            self._end_full_chunk()

    def end_chunk(self) -> None:
        """Close the open chunk, if it holds messages, and hand it to the file."""
        if not self._chunk.counts:
            return
        data, index = self._chunk.closed(self._compressor, self._position)
        self._put(data)
        self._summary.add_chunk(index, self._chunk.counts)
        self._chunk = OpenChunk()

    def abandon_chunk(self) -> dict[int, int]:
        """Forget the open chunk; returns how many messages of each channel were in it."""
        lost = self._chunk.counts
        for channel_id, count in lost.items():
            self._sequences[channel_id] -= count
        self._new_schemas = list(self._summary.schemas.values())
        self._chunk = OpenChunk()
        return lost

    def finish(self) -> None:
        """Write the last chunk and the summary. The file stays open."""
        self.end_chunk()
        end = record_bytes(DataEnd(data_section_crc=self._crc))
        self._put(end + self._summary.encoded(self._position + len(end)))

    def _put(self, data: bytes) -> int:
        self._sink.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._position += len(data)
        return len(data)

    def _declare(self, channel_id: int) -> None:
        """Name a channel in the open chunk, before its first message there."""
        if not self._chunk.names(channel_id):
            definitions = [*self._new_schemas, self._summary.channels[channel_id]]
            self._chunk.name(channel_id, b"".join(map(record_bytes, definitions)))
            self._new_schemas.clear()

    def _end_full_chunk(self) -> None:
        if self._chunk.room <= 0:
            self.end_chunk()
