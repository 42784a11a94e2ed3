"""MCAP records as they are read: one record's bytes -> a checked value.

The mcap library reads past a short record without a word, and allocates what a damaged
length asks for. Here every length is checked against the bytes that are there, before
anything is taken from them. Pure: no file. All functions raise `Malformed`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

MAGIC = b"\x89MCAP0\r\n"
"""How a file begins and ends."""

HEAD_BYTES = 9
"""Opcode and length, before the content of a record."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
ATTACHMENT, METADATA, DATA_END = 9, 12, 15
FIRST_PRIVATE = 0x80
"""Opcodes; from the last on, records are anybody's."""

MAX_CHUNK_BYTES = 256 * 1024 * 1024
"""Largest uncompressed chunk that is read; writers use 64 KiB to a few MiB."""

MOST_RATIO = 1000
"""Largest ratio of compression that is read of a chunk above 1 MiB; readings reach some tens."""

_ANY_RATIO_BYTES = 1 << 20
_UNKNOWN = -1  # size of a zstd frame that does not say it
_PIECE = 1 << 20
_CHUNK = struct.Struct("<QQQII")  # up to the name of the compression


class Malformed(ValueError):
    """A record does not say what a record of its kind must say."""


@dataclass(frozen=True, slots=True)
class Schema:
    """Id and name of a message schema."""

    id: int
    name: str
    encoding: str


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of messages of one schema (id 0: none)."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str


class Chunk(NamedTuple):
    """Compressed records with the time span of their messages [ns]."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    data: bytes


class _Fields:
    """The fields of one record, taken one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def left(self) -> int:
        return len(self._data) - self._at

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        return _text(self.take(self.number(4)))

    def take(self, size: int) -> bytes:
        end = self._at + size
        if end > len(self._data):
            raise Malformed(f"a field of {size} bytes where {self.left} are left")
        part = self._data[self._at : end]
        self._at = end
        return part


def _text(letters: bytes) -> str:
    try:
        return letters.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Malformed("a text that is not UTF-8") from error


def parse_header(content: bytes) -> tuple[str, str]:
    """Profile and library."""
    fields = _Fields(content)
    return fields.text(), fields.text()


def parse_schema(content: bytes) -> Schema:
    """A Schema record, without the schema itself."""
    fields = _Fields(content)
    schema = Schema(id=fields.number(2), name=fields.text(), encoding=fields.text())
    fields.take(fields.number(4))
    return schema


def parse_channel(content: bytes) -> Channel:
    """A Channel record, without its metadata."""
    fields = _Fields(content)
    channel = Channel(
        id=fields.number(2),
        schema_id=fields.number(2),
        topic=fields.text(),
        message_encoding=fields.text(),
    )
    fields.take(fields.number(4))
    return channel


def parse_attachment(content: bytes) -> tuple[str, bytes]:
    """Name and data; checks the CRC, where there is one."""
    fields = _Fields(content)
    fields.take(16)
    name = fields.text()
    fields.text()
    data = fields.take(fields.number(8))
    covered = len(content) - fields.left
    crc = fields.number(4)
    if crc not in (0, zlib.crc32(content[:covered])):
        raise Malformed(f"attachment '{name}' with a wrong CRC")
    return name, data


def parse_metadata(content: bytes) -> tuple[str, dict[str, str]]:
    """Name and pairs."""
    fields = _Fields(content)
    name = fields.text()
    inner = _Fields(fields.take(fields.number(4)))
    pairs = {}
    while inner.left:
        key = inner.text()
        pairs[key] = inner.text()
    return name, pairs


def check_message_index(content: bytes) -> None:
    """A Message Index must be as long as it says."""
    if len(content) < 6 or int.from_bytes(content[2:6], "little") != len(content) - 6:
        raise Malformed("a message index of another length than it says")


def parse_footer(content: bytes) -> tuple[int, int, int]:
    """Start of the summary, start of the summary offsets, CRC of the summary."""
    fields = _Fields(content)
    return fields.number(8), fields.number(8), fields.number(4)


def parse_chunk(content: bytes) -> Chunk:
    """A Chunk record, still compressed."""
    data_at = _CHUNK.size + 8  # and the letters of the compression
    if len(content) >= data_at:
        start_ns, end_ns, size, crc, letters = _CHUNK.unpack_from(content)
        data_at += letters
    if len(content) < data_at:
        raise Malformed(f"a chunk of {len(content)} bytes, shorter than its head")
    compression = _text(content[_CHUNK.size : data_at - 8])
    data, length = content[data_at:], int.from_bytes(content[data_at - 8 : data_at], "little")
    if len(data) != length:
        raise Malformed(f"a chunk with {len(data)} bytes of data that should have {length}")
    return Chunk(start_ns, end_ns, size, crc, compression, data)


def decompress(chunk: Chunk, zstd: zstandard.ZstdDecompressor | None = None) -> bytes:
    """The records of a chunk, checked against its size and CRC (0: the chunk has none).

    Who has many chunks hands in a decompressor, which costs as much to make as a chunk to read.
    """
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise Malformed(f"a chunk of {size} bytes, above the limit of {MAX_CHUNK_BYTES}")
    if size > max(_ANY_RATIO_BYTES, MOST_RATIO * len(chunk.data)):
        raise Malformed(
            f"a chunk of {size} bytes out of {len(chunk.data)}: nothing recorded is so alike"
        )
    if chunk.compression == "zstd":
        data = _unzstd(chunk.data, size, zstd or zstandard.ZstdDecompressor())
    elif chunk.compression == "lz4":
        data = _unlz4(chunk.data, size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise Malformed(f"a chunk compressed with '{chunk.compression}', expected zstd or lz4")
    if len(data) != size:
        raise Malformed(f"a chunk of {len(data)} bytes that should have {size}")
    if chunk.crc not in (0, zlib.crc32(data)):
        raise Malformed("a chunk with a wrong CRC")
    return data


def _unzstd(data: bytes, size: int, zstd: zstandard.ZstdDecompressor) -> bytes:
    try:
        # A frame may itself claim any size, and the library would allocate it.
        claimed = zstandard.frame_content_size(data)
        if claimed == size:
            return zstd.decompress(data)
        if claimed != _UNKNOWN:
            raise Malformed(f"a chunk of {claimed} bytes that should have {size}")
        with zstd.stream_reader(data) as stream:
            return _collect(stream.read, size)
    except zstandard.ZstdError as error:
        raise Malformed(f"a chunk that does not decompress ({error})") from error


def _unlz4(data: bytes, size: int) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    left = iter((data,))
    try:
        out = _collect(lambda count: decompressor.decompress(next(left, b""), count), size)
    except (RuntimeError, EOFError) as error:
        raise Malformed(f"a chunk that does not decompress ({error})") from error
    return out


def _collect(read: Callable[[int], bytes], size: int) -> bytes:
    """Up to ``size`` + 1 bytes, in pieces, because a stated size is no reason to allocate it."""
    out = bytearray()
    while len(out) <= size:
        piece = read(min(_PIECE, size + 1 - len(out)))
        if not piece:
            break
        out += piece
    return bytes(out)
