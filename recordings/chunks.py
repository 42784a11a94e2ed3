"""What is in an MCAP file, block by block, whatever state the file is in.

Owns the walk through a file: it yields the records of each chunk as one block, checks
every CRC there is, and goes on behind what is damaged at the next chunk that can be found.
Memory is bounded by the largest chunk, not by the file. Knows nothing of loopcal.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import zstandard

from recordings import records
from recordings.container import MAGIC
from recordings.offsets import HEAD_BYTES, leading_bytes
from recordings.records import MAX_CHUNK_BYTES, Malformed
from recordings.stream import PIECE_BYTES, Stream
from recordings.wire import unaligned

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
ATTACHMENT, METADATA, DATA_END = 9, 12, 15
FIRST_PRIVATE = 0x80

LARGEST_BLOCK = 4 * 1024 * 1024
"""Bytes above which the records of a chunk are given in several blocks."""

_HEAD = HEAD_BYTES
_TAIL = _HEAD + 20 + len(MAGIC)
_FEWEST_LOOSE = 1 << 12
_CHUNK_HEAD = 53  # from the opcode to the length of the compressed data, at most
_INDEX = struct.Struct("<BQHI")  # a message index up to its entries
_LOOSE = tuple(bytes([opcode]) for opcode in (SCHEMA, CHANNEL, MESSAGE))
_ATTACHMENT_HEAD = 29  # from the opcode to the length of the name
_LONGEST_NAME = 256  # of an attachment that is searched for
_COMPRESSIONS = (b"", b"lz4", b"zstd")


@dataclass(frozen=True, slots=True)
class Header:
    """The file's own header."""

    profile: str
    library: str


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file within the file."""

    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Metadata:
    """Named key-value pairs."""

    name: str
    pairs: dict[str, str]


@dataclass(frozen=True, slots=True)
class Block:
    """Schema, Channel and Message records, one behind the other, of what was found at byte ``offset``."""

    offset: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Damage:
    """What is wrong at byte ``offset``."""

    offset: int
    text: str

    def __str__(self) -> str:
        return f"byte {self.offset}: {self.text}"


Item = Header | Attachment | Metadata | Block | Damage


def scan(file: BinaryIO, size: int) -> Iterator[Item]:
    """All that is in an MCAP file.

    First the header and the schemas and channels of the summary (as a block), because a
    damaged file may have lost them elsewhere; then the data section in file order.

    Args:
        file: the file, opened for reading in binary; it must be seekable.
        size: its size in bytes.

    Raises:
        Malformed: the file does not begin as MCAP, and holds no chunk near its beginning either.
        OSError: the disk failed.
    """
    if _read(file, 0, len(MAGIC)) != MAGIC:
        # A damaged beginning does not make another kind of file of it.
        if _next_chunk(file, 0, min(size, PIECE_BYTES)) is None:
            raise Malformed("it does not begin with the MCAP magic bytes")
        yield Damage(0, "it does not begin with the MCAP magic bytes")
    tail = _read_tail(file, size)
    yield from _Walk(file, size if tail is None else size - _TAIL, tail).items()


@dataclass(frozen=True, slots=True)
class _Tail:
    """The end of a closed file: where its summary is, what it defines, what is wrong there."""

    summary_start: int
    definitions: Block | None
    damage: Damage | None


def _read(file: BinaryIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    return file.read(size)


def _read_tail(file: BinaryIO, size: int) -> _Tail | None:
    """The footer and the summary, or None where the file does not end with a footer."""
    footer_at = size - _TAIL
    if footer_at < len(MAGIC):
        return None
    tail = _read(file, footer_at, _TAIL)
    if tail[:_HEAD] != bytes([FOOTER]) + (20).to_bytes(8, "little") or tail[-8:] != MAGIC:
        return None
    start, _, crc = records.parse_footer(tail[_HEAD:-8])
    if start == 0:
        return _Tail(0, None, None)
    if not len(MAGIC) <= start <= footer_at:
        return _Tail(0, None, Damage(footer_at, "a footer that points outside the file"))
    found = 0
    definitions = bytearray()
    # One pass in pieces for the CRC, one from record to record for the definitions.
    for piece in _pieces(file, start, footer_at):
        found = zlib.crc32(piece, found)
    if crc not in (0, zlib.crc32(tail[: _HEAD + 16], found)):
        return _Tail(start, None, Damage(start, "a summary with a wrong CRC"))
    at = start
    while at + _HEAD <= footer_at:
        head = _read(file, at, _HEAD)
        skip_to = at + _HEAD + int.from_bytes(head[1:], "little")
        if skip_to > footer_at or len(definitions) > MAX_CHUNK_BYTES:
            break
        if head[0] in (SCHEMA, CHANNEL):
            definitions += _read(file, at, skip_to - at)
        at = skip_to
    damage = None if at == footer_at else Damage(at, "a malformed summary")
    return _Tail(start, Block(start, bytes(definitions)), damage)


def _pieces(file: BinaryIO, start: int, stop: int) -> Iterator[bytes]:
    file.seek(start)
    while start < stop:
        piece = file.read(min(PIECE_BYTES, stop - start))
        if not piece:
            return
        start += len(piece)
        yield piece


class _Walk:
    """One walk through the data section."""

    def __init__(self, file: BinaryIO, stop: int, tail: _Tail | None) -> None:
        self._file = file
        self._stop = stop
        self._tail = tail
        self._stream = Stream(file, len(MAGIC), zlib.crc32(MAGIC))
        self._trusted = len(MAGIC)  # end of the last record that proved to be whole
        self._zstd = zstandard.ZstdDecompressor()
        self._loose = _FEWEST_LOOSE  # bytes to look at together outside chunks
        self._data_crc: int | None = None  # known once the end of the data section was found
        self._doubted = False  # a chunk was bad: the CRC of all data would only repeat it
        self._ended = False
        self._chunked = False  # a file has its messages in chunks, or it has no chunks

    def items(self) -> Iterator[Item]:
        try:
            opcode, content = self._take()
            if opcode != HEADER:
                raise Malformed(f"a record of type {opcode} where the header should be")
            yield Header(*records.parse_header(content))
            self._trusted = self._stream.at
        except Malformed as error:
            yield self._damage(len(MAGIC), error)
        if self._tail is not None and self._tail.definitions is not None:
            yield self._tail.definitions
        yield from self._data()
        if self._tail is None:
            yield Damage(self._stop, "the file ends without a footer: it was never closed, or cut")
        elif self._tail.damage is not None:
            yield self._tail.damage
        elif self._ended and self._tail.summary_start not in (0, self._stream.at):
            yield Damage(self._stream.at, "stray bytes between the data and the summary")

    def _data(self) -> Iterator[Item]:
        while True:
            self._pass_indexes()
            at = self._stream.at
            if at >= self._stop or self._ended:
                break
            try:
                if (loose := self._take_loose()) is not None:
                    yield loose
                    continue
                opcode, content = self._take()
                item = self._item(opcode, content)
            except Malformed as error:
                item = self._damage(at, error)
            if isinstance(item, Block):
                yield from _parts(item)
            elif item is not None:
                yield item
        if not self._ended and self._tail is not None:
            yield Damage(self._stream.at, "the data section has no end record")

    def _pass_indexes(self) -> None:
        """Pass over sound message indexes, one a topic behind each chunk, as far as is read ahead."""
        held, before = self._stream.held()
        last = min(len(held), before + self._stop - self._stream.at)
        at = before
        while at + _INDEX.size <= last:
            opcode, length, _, count = _INDEX.unpack_from(held, at)
            end = at + _HEAD + length
            if opcode != MESSAGE_INDEX or count != length - 6 or end > last:
                break
            at = end
        if at > before:
            self._stream.pass_over(at - before)
            self._trusted = self._stream.at

    def _take_loose(self) -> Block | None:
        """Records outside chunks, as many as are near; None where there are none."""
        opcode = self._stream.peek(1)[:1]
        if opcode not in _LOOSE:
            return None
        if self._chunked and opcode[0] == MESSAGE:
            # Nothing vouches for it, and one wrong bit makes a message of a message index.
            raise Malformed("a message outside chunks, in a file of chunks")
        at = self._stream.at
        size = leading_bytes(self._stream.peek(min(self._loose, self._stop - at)))
        self._loose = min(PIECE_BYTES, max(_FEWEST_LOOSE, 2 * size))
        if size:
            return Block(at, self._stream.take(size))
        kind, content = self._take()
        return Block(at, bytes([kind]) + len(content).to_bytes(8, "little") + content)

    def _take(self) -> tuple[int, bytes]:
        """Opcode and content of the next record; leaves out the content of private records."""
        head = self._stream.peek(_HEAD)
        if len(head) < _HEAD:
            raise Malformed("the file ends inside a record")
        opcode, length = head[0], int.from_bytes(head[1:], "little")
        if opcode == DATA_END:
            self._data_crc = self._stream.crc
        self._stream.take(_HEAD)
        left = self._stop - self._stream.at
        if length > left:
            raise Malformed(f"a record of {length} bytes (type {opcode}), where {left} are left")
        if opcode >= FIRST_PRIVATE:
            self._stream.pass_over(length)
            return opcode, b""
        if length > MAX_CHUNK_BYTES:
            raise Malformed(f"a record of {length} bytes, above the limit of {MAX_CHUNK_BYTES}")
        return opcode, self._stream.take(length)

    def _item(self, opcode: int, content: bytes) -> Item | None:
        if opcode >= FIRST_PRIVATE:
            return None
        item: Item | None = None
        if opcode == CHUNK:
            chunk = records.parse_chunk(content)
            self._chunked = True
            self._trusted = self._stream.at
            item = self._block(chunk, len(content))
        elif opcode == MESSAGE_INDEX:
            records.check_message_index(content)
        elif opcode == ATTACHMENT:
            item = Attachment(*records.parse_attachment(content))
        elif opcode == METADATA:
            item = Metadata(*records.parse_metadata(content))
        elif opcode == DATA_END:
            item = self._end(content)
        else:
            raise Malformed(f"a record of type {opcode}, which has no place here")
        self._trusted = self._stream.at
        return item

    def _block(self, chunk: records.Chunk, length: int) -> Block | Damage:
        at = self._stream.at - length - _HEAD
        try:
            return Block(at, records.decompress(chunk, self._zstd))
        except Malformed as error:
            self._doubted = True
            seconds = (chunk.end_ns - chunk.start_ns) * 1e-9
            return Damage(at, f"{error}; its messages (a span of {seconds:.3f} s) are lost")

    def _end(self, content: bytes) -> Damage | None:
        if len(content) != 4:
            raise Malformed("an end record of the wrong length")
        self._ended = True
        crc = int.from_bytes(content, "little")
        known = self._data_crc is not None and not self._doubted
        if known and crc not in (0, self._data_crc):
            return Damage(self._stream.at, "the data section has a wrong CRC")
        return None

    def _damage(self, at: int, error: Malformed) -> Damage:
        """Note damage at ``at``; go on at the next chunk or attachment behind what is trusted."""
        chunk = _next_chunk(self._file, self._trusted, self._stop)
        stop = self._stop if chunk is None else chunk
        attachment = _next_attachment(self._file, self._trusted, stop)
        self._trusted = stop if attachment is None else attachment
        self._stream.go_to(self._trusted)
        skipped = self._trusted - at
        return Damage(at, f"{error}; went on {skipped} bytes later" if skipped > 0 else str(error))


def _parts(block: Block) -> Iterator[Block]:
    """A large block in parts of whole records, so that nobody makes arrays about all of it at once."""
    data = block.data
    while len(data) > LARGEST_BLOCK and (size := leading_bytes(data[:LARGEST_BLOCK])):
        yield Block(block.offset, data[:size])
        data = data[size:]
    yield block if data is block.data else Block(block.offset, data)


def _next_chunk(file: BinaryIO, start: int, stop: int) -> int | None:
    """Offset of the first chunk between ``start`` and ``stop`` whose inner lengths agree."""
    while start + _CHUNK_HEAD <= stop:
        data = _read(file, start, min(PIECE_BYTES, stop - start))
        if len(data) < _CHUNK_HEAD:
            return None
        places = np.flatnonzero(np.frombuffer(data, np.uint8)[: 1 - _CHUNK_HEAD] == CHUNK)
        length = unaligned(data, "<u8", 1)[places]
        fits = (length <= MAX_CHUNK_BYTES) & (length <= stop - start - _HEAD - places)
        whole = np.zeros(len(places), np.bool_)
        for name in _COMPRESSIONS:
            letters = unaligned(data, "<u4", 37)[places] == len(name)
            inside = unaligned(data, "<u8", 41 + len(name))[places]
            whole |= fits & letters & (length == inside + np.uint64(40 + len(name)))
        for place in places[whole].tolist():
            if data[place + 41 : place + 41 + data[place + 37]] in _COMPRESSIONS:
                return int(start + place)
        start += len(data) - _CHUNK_HEAD + 1
    return None


def _next_attachment(file: BinaryIO, start: int, stop: int) -> int | None:
    """Offset of the first attachment between ``start`` and ``stop`` whose CRC is right."""
    while start + _ATTACHMENT_HEAD <= stop:
        data = _read(file, start, min(PIECE_BYTES, stop - start))
        if len(data) < _ATTACHMENT_HEAD:
            return None
        head = np.frombuffer(data, np.uint8)[: 1 - _ATTACHMENT_HEAD]
        places = np.flatnonzero(head == ATTACHMENT)
        length = unaligned(data, "<u8", 1)[places]
        fits = (length <= MAX_CHUNK_BYTES) & (length <= stop - start - _HEAD - places)
        fits &= unaligned(data, "<u4", 25)[places] < _LONGEST_NAME
        for place in places[fits].tolist():
            size = int.from_bytes(data[place + 1 : place + _HEAD], "little")
            content = _read(file, start + place + _HEAD, size)
            try:
                records.parse_attachment(content)
            except Malformed:
                continue
            if content[-4:] != bytes(4):
                return int(start + place)
        start += len(data) - _ATTACHMENT_HEAD + 1
    return None
