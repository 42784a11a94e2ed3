"""What is in an MCAP file, block by block, whatever state the file is in.

Owns the walk through a file: it yields the records of each chunk as one block, checks
every CRC there is, and goes on behind what is damaged at the next chunk that can be found.
Memory is bounded by the largest chunk, not by the file. Knows nothing of loopcal.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import zstandard

from recordings import records
from recordings.items import Attachment, Block, Damage, Header, Item, Metadata
from recordings.offsets import leading_bytes
from recordings.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FIRST_PRIVATE,
    HEAD_BYTES,
    HEADER,
    MAGIC,
    MAX_CHUNK_BYTES,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    Malformed,
)
from recordings.resume import next_chunk, next_sound
from recordings.stream import PIECE_BYTES, Stream
from recordings.tail import TAIL_BYTES, Tail, read_tail

LARGEST_BLOCK = 4 * 1024 * 1024
"""Bytes above which the records of a chunk are given in several blocks."""

_FEWEST_LOOSE = 1 << 12
_HEAD = struct.Struct("<BQ")
_INDEX = struct.Struct("<BQHI")  # a message index up to its entries
_LOOSE = tuple(bytes([opcode]) for opcode in (SCHEMA, CHANNEL, MESSAGE))


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
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        # A damaged beginning does not make another kind of file of it.
        if next_chunk(file, 0, min(size, PIECE_BYTES)) is None:
            raise Malformed("it does not begin with the MCAP magic bytes")
        yield Damage(0, "it does not begin with the MCAP magic bytes")
    tail = read_tail(file, size)
    yield from _Walk(file, size if tail is None else size - TAIL_BYTES, tail).items()


class _Walk:
    """One walk through the data section."""

    def __init__(self, file: BinaryIO, stop: int, tail: Tail | None) -> None:
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
                item = self._next(at)
            except Malformed as error:
                item = self._damage(at, error)
            if isinstance(item, Block) and len(item.data) > LARGEST_BLOCK:
                yield from _parts(item)
            elif item is not None:
                yield item
        if not self._ended and self._tail is not None:
            yield Damage(self._stream.at, "the data section has no end record")

    def _pass_indexes(self) -> None:
        """Pass over sound message indexes, one a topic behind each chunk, as far as is read ahead."""
        held, before = self._stream.held()
        stop = min(len(held), before + self._stop - self._stream.at)
        last = stop - _INDEX.size
        at = before
        while at <= last:
            opcode, length, _, count = _INDEX.unpack_from(held, at)
            end = at + HEAD_BYTES + length
            if opcode != MESSAGE_INDEX or count != length - 6 or end > stop:
                break
            at = end
        if at > before:
            self._stream.pass_over(at - before)
            self._trusted = self._stream.at

    def _next(self, at: int) -> Item | None:
        """The record, or the records outside chunks, at byte ``at``; None where there is nothing to tell."""
        opcode = self._stream.peek(1)
        if opcode in _LOOSE:
            return self._loose_records(at, opcode[0])
        return self._item(*self._take())

    def _loose_records(self, at: int, opcode: int) -> Block:
        """Records outside chunks, as many as are near."""
        if self._chunked and opcode == MESSAGE:
            # Nothing vouches for it, and one wrong bit makes a message of a message index.
            raise Malformed("a message outside chunks, in a file of chunks")
        size = leading_bytes(self._stream.peek(min(self._loose, self._stop - at)))
        self._loose = min(PIECE_BYTES, max(_FEWEST_LOOSE, 2 * size))
        if size:
            return Block(at, self._stream.take(size))
        kind, content = self._take()
        return Block(at, _HEAD.pack(kind, len(content)) + content)

    def _take(self) -> tuple[int, bytes]:
        """Opcode and content of the next record; leaves out the content of private records."""
        head = self._stream.peek(HEAD_BYTES)
        if len(head) < HEAD_BYTES:
            raise Malformed("the file ends inside a record")
        opcode, length = _HEAD.unpack(head)
        if opcode == DATA_END:
            self._data_crc = self._stream.crc
        self._stream.pass_over(HEAD_BYTES)
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
        at = self._stream.at - length - HEAD_BYTES
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
        self._trusted = next_sound(self._file, self._trusted, self._stop)
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
