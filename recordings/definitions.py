"""The schemas and channels that a file defines, whole, as they are to be copied.

Owns which definition of an id counts: the first. Files repeat definitions, so that much of
a file can be lost and all of them still be known.
"""

from __future__ import annotations

import io
import struct

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from recordings import codec, records
from recordings.records import CHANNEL, SCHEMA, Malformed


class Definitions:
    """Schemas and channels by their ids."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._seen: set[bytes] = set()

    def take(self, data: bytes, offsets: NDArray[np.int64]) -> list[str]:
        """Take the Schema and Channel records among those at ``offsets``.

        Returns:
            what is wrong with them, a line each.
        """
        wrong = []
        opcodes = np.frombuffer(data, np.uint8)[offsets]
        for at in offsets[(opcodes == SCHEMA) | (opcodes == CHANNEL)].tolist():
            end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
            if data[at:end] in self._seen:
                continue
            self._seen.add(data[at:end])
            try:
                same = self._define(data[at], data[at + 9 : end])
            except Malformed as error:
                wrong.append(str(error))
                continue
            if not same:
                wrong.append("a second definition of a schema or channel")
        return wrong

    def _define(self, opcode: int, content: bytes) -> bool:
        """Whether it agrees with what was known."""
        # The library reads past a short record without a word; the own parser checks first.
        stream = ReadDataStream(io.BytesIO(content))
        if opcode == SCHEMA:
            schema_id = records.parse_schema(content).id
            schema = Schema.read(stream)
            return bool(self.schemas.setdefault(schema_id, schema) == schema)
        channel_id = records.parse_channel(content).id
        try:
            channel = Channel.read(stream)
        except (EndOfFile, struct.error, UnicodeDecodeError) as error:
            raise Malformed(f"a channel that cannot be read ({error})") from error
        return bool(self.channels.setdefault(channel_id, channel) == channel)

    def complete(self) -> None:
        """Replace schemas that are lost: those of the format are known, others are done without."""
        for channel in self.channels.values():
            if channel.schema_id in self.schemas or channel.schema_id == 0:
                continue
            topic = codec.kind_of_topic(channel.topic)
            if topic is None:
                channel.schema_id = 0
                continue
            kind, _ = topic
            self.schemas[channel.schema_id] = Schema(
                id=channel.schema_id,
                data=codec.schema_data(kind),
                encoding="protobuf",
                name=kind.schema_name,
            )
