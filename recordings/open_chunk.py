"""The chunk of an MCAP file that is being filled.

Owns its records, the index of its messages, and that it names its channels before their first
message, so that it can be read even where all chunks before it are lost. Knows no file.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex
from numpy.typing import NDArray

from recordings.summary import record_bytes

CHUNK_BYTES = 256 * 1024
"""Uncompressed size at which a chunk is closed: what a session of seven channels at 1 kHz writes between
two flushes fits in, and a damaged one costs little."""

_INDEX_ENTRY = struct.Struct("<QQ")
_INDEX_ROW = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class OpenChunk:
    """Takes records, until it has no room."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._indexes: dict[int, bytearray] = {}
        self._first_ns = 2**64
        self._last_ns = 0

    @property
    def room(self) -> int:
        """Bytes until it is to be closed; 0 or less when it is."""
        return CHUNK_BYTES - len(self._data)

    @property
    def counts(self) -> dict[int, int]:
        """Messages in it, by channel id."""
        return {key: len(index) // _INDEX_ROW.itemsize for key, index in self._indexes.items()}

    def names(self, channel_id: int) -> bool:
        """Whether a channel is named in it."""
        return channel_id in self._indexes

    def name(self, channel_id: int, definitions: bytes) -> None:
        """Name a channel by the records that define it, before its first message here."""
        self._data += definitions
        self._indexes[channel_id] = bytearray()

    def add(self, channel_id: int, time_ns: int, record: bytes) -> None:
        """Take one Message record."""
        self._indexes[channel_id] += _INDEX_ENTRY.pack(time_ns, len(self._data))
        self._data += record
        self._span(time_ns, time_ns)

    def add_rows(self, channel_id: int, rows: NDArray[np.void]) -> int:
        """Take Message records of one channel, as many as there is room for; returns how many."""
        size = rows.dtype.itemsize
        now = rows[: max(1, -(-self.room // size))]
        entries = np.empty(len(now), _INDEX_ROW)
        entries["log_time"] = now["log_time"]
        entries["offset"] = len(self._data) + size * np.arange(len(now))
        self._indexes[channel_id] += entries.tobytes()
        self._data += now.tobytes()
        self._span(int(now["log_time"].min()), int(now["log_time"].max()))
        return len(now)

    def add_copies(
        self,
        data: bytes,
        start: NDArray[np.int64],
        stop: NDArray[np.int64],
        channel_id: NDArray[np.uint16],
        time_ns: NDArray[np.int64],
    ) -> None:
        """Take Message records (n,) from ``start`` to ``stop`` in ``data``, all of channels that are named."""
        size = stop - start
        entries = np.empty(len(start), _INDEX_ROW)
        entries["log_time"] = time_ns
        entries["offset"] = len(self._data) + np.cumsum(size) - size
        for each in np.unique(channel_id).tolist():
            self._indexes[each] += entries[channel_id == each].tobytes()
        self._data += b"".join(_runs(data, start, stop))
        self._span(int(time_ns.min()), int(time_ns.max()))

    def closed(self, compressor: zstandard.ZstdCompressor, offset: int) -> tuple[bytes, ChunkIndex]:
        """The chunk with its message indexes, to be written at byte ``offset``; and where all that is."""
        data = bytes(self._data)
        compressed = compressor.compress(data)
        chunk = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=self._first_ns,
            message_end_time=self._last_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        written = bytearray(record_bytes(chunk))
        length = len(written)
        offsets: dict[int, int] = {}
        for channel_id, entries in self._indexes.items():
            offsets[channel_id] = offset + len(written)
            written += struct.pack(
                "<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), channel_id, len(entries)
            )
            written += entries
        return bytes(written), ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression="zstd",
            compressed_size=len(compressed),
            message_end_time=self._last_ns,
            message_index_length=len(written) - length,
            message_index_offsets=offsets,
            message_start_time=self._first_ns,
            uncompressed_size=len(data),
        )

    def _span(self, first_ns: int, last_ns: int) -> None:
        self._first_ns = min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)


def _runs(data: bytes, start: NDArray[np.int64], stop: NDArray[np.int64]) -> Iterator[bytes]:
    """The pieces of ``data`` from each start to its stop, those that touch in one."""
    breaks = np.flatnonzero(start[1:] != stop[:-1])
    firsts, lasts = [0, *(breaks + 1).tolist()], [*breaks.tolist(), len(start) - 1]
    for first, last in zip(firsts, lasts, strict=True):
        yield data[int(start[first]) : int(stop[last])]
