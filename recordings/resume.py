"""Where the reading of a damaged file can go on: at a chunk or an attachment, found by its bytes.

A chunk is known by its two lengths, which must agree, an attachment by its CRC. No length is
believed before it is compared with the bytes that are there.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from recordings import records
from recordings.records import ATTACHMENT, CHUNK, HEAD_BYTES, MAX_CHUNK_BYTES, Malformed
from recordings.stream import PIECE_BYTES
from recordings.wire import unaligned

_CHUNK_HEAD = 53  # from the opcode to the length of the compressed data, at most
_ATTACHMENT_HEAD = 29  # from the opcode to the length of the name
_LONGEST_NAME = 256  # of an attachment that is searched for
_COMPRESSIONS = (b"", b"lz4", b"zstd")


def next_sound(file: BinaryIO, start: int, stop: int) -> int:
    """Offset of the first chunk or attachment between ``start`` and ``stop``; ``stop`` where there is none."""
    chunk = next_chunk(file, start, stop)
    stop = stop if chunk is None else chunk
    attachment = _next_attachment(file, start, stop)
    return stop if attachment is None else attachment


def next_chunk(file: BinaryIO, start: int, stop: int) -> int | None:
    """Offset of the first chunk between ``start`` and ``stop`` whose inner lengths agree."""
    while start + _CHUNK_HEAD <= stop:
        data = _read(file, start, min(PIECE_BYTES, stop - start))
        if len(data) < _CHUNK_HEAD:
            return None
        places = np.flatnonzero(np.frombuffer(data, np.uint8)[: 1 - _CHUNK_HEAD] == CHUNK)
        length = unaligned(data, "<u8", 1)[places]
        fits = (length <= MAX_CHUNK_BYTES) & (length <= stop - start - HEAD_BYTES - places)
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
        fits = (length <= MAX_CHUNK_BYTES) & (length <= stop - start - HEAD_BYTES - places)
        fits &= unaligned(data, "<u4", 25)[places] < _LONGEST_NAME
        for place in places[fits].tolist():
            size = int.from_bytes(data[place + 1 : place + HEAD_BYTES], "little")
            content = _read(file, start + place + HEAD_BYTES, size)
            try:
                records.parse_attachment(content)
            except Malformed:
                continue
            if content[-4:] != bytes(4):
                return int(start + place)
        start += len(data) - _ATTACHMENT_HEAD + 1
    return None


def _read(file: BinaryIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    return file.read(size)
