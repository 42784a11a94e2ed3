"""The summary at the end of an MCAP file: definitions, statistics, and where everything is.

Owns what the summary must remember of a file while it is written, and how long it will be, so
that room can be held back for it.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from recordings.records import MAGIC

_INDEX_BYTES = 128  # of one record in the summary, at most, beside what varies


class Summary:
    """What is known of a file so far.

    Attributes:
        schemas, channels: definitions by id.
        counts: messages in the chunks that were written, by channel id.
        attachments, metadata: where they are.
    """

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.attachments: list[AttachmentIndex] = []
        self.metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._definition_bytes = 0

    def define_schema(self, schema: Schema) -> None:
        """Take a schema, whose id is new here."""
        self.schemas[schema.id] = schema
        self._definition_bytes += len(record_bytes(schema))

    def define_channel(self, channel: Channel) -> None:
        """Take a channel, whose id is new here."""
        self.channels[channel.id] = channel
        self._definition_bytes += len(record_bytes(channel))

    def add_chunk(self, index: ChunkIndex, counts: dict[int, int]) -> None:
        """A chunk was written, with so many messages of each channel."""
        self._chunks.append(index)
        self.counts.update(counts)

    @property
    def most_bytes(self) -> int:
        """Bytes of `encoded`, at most."""
        indexes = len(self._chunks) * (_INDEX_BYTES + 10 * len(self.channels))
        others = len(self.attachments) + len(self.metadata)
        statistics = _INDEX_BYTES + 10 * len(self.channels)
        return self._definition_bytes + indexes + statistics + (others + 4) * _INDEX_BYTES

    def encoded(self, start: int) -> bytes:
        """Summary, footer and magic, which begin at byte ``start``."""
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self.schemas.values()]),
            (Opcode.CHANNEL, [*self.channels.values()]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self.attachments]),
            (Opcode.METADATA_INDEX, [*self.metadata]),
        )
        summary = bytearray()
        offsets = bytearray()
        for opcode, records in groups:
            if records:
                group = b"".join(map(record_bytes, records))
                place = SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
                )
                summary += group
                offsets += record_bytes(place)
        offsets_start = start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(head, zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc)
        return bytes(summary) + record_bytes(footer) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.counts.total(),
            message_end_time=max((each.message_end_time for each in self._chunks), default=0),
            message_start_time=min((each.message_start_time for each in self._chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def record_bytes(record: McapRecord) -> bytes:
    """A record of the mcap library, as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
