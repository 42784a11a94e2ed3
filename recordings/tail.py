"""The end of a closed MCAP file: its footer, and the definitions in its summary.

Owns whether a file was closed at all, and that a summary is believed only where its CRC is right.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import BinaryIO

from recordings import records
from recordings.items import Block, Damage
from recordings.records import CHANNEL, FOOTER, HEAD_BYTES, MAGIC, MAX_CHUNK_BYTES, SCHEMA
from recordings.stream import Stream

TAIL_BYTES = HEAD_BYTES + 20 + len(MAGIC)
"""The footer and the magic behind it."""


@dataclass(frozen=True, slots=True)
class Tail:
    """Where the summary of a closed file is, what it defines, what is wrong there."""

    summary_start: int
    definitions: Block | None
    damage: Damage | None


def read_tail(file: BinaryIO, size: int) -> Tail | None:
    """The footer and the summary, or None where the file does not end with a footer."""
    footer_at = size - TAIL_BYTES
    if footer_at < len(MAGIC):
        return None
    file.seek(footer_at)
    tail = file.read(TAIL_BYTES)
    footer = bytes([FOOTER]) + (20).to_bytes(8, "little")
    if tail[:HEAD_BYTES] != footer or tail[-len(MAGIC) :] != MAGIC:
        return None
    start, _, crc = records.parse_footer(tail[HEAD_BYTES : -len(MAGIC)])
    if start == 0:
        return Tail(0, None, None)
    if not len(MAGIC) <= start <= footer_at:
        return Tail(0, None, Damage(footer_at, "a footer that points outside the file"))
    stream = Stream(file, start, 0)
    definitions = _definitions(stream, footer_at)
    whole = stream.at == footer_at
    damage = None if whole else Damage(stream.at, "a malformed summary")
    stream.pass_over(footer_at - stream.at)
    if crc not in (0, zlib.crc32(tail[: HEAD_BYTES + 16], stream.crc or 0)):
        return Tail(start, None, Damage(start, "a summary with a wrong CRC"))
    return Tail(start, Block(start, definitions), damage)


def _definitions(stream: Stream, stop: int) -> bytes:
    """The schemas and channels among the records up to ``stop``, or up to one that goes beyond it."""
    definitions = bytearray()
    while stream.at + HEAD_BYTES <= stop and len(definitions) <= MAX_CHUNK_BYTES:
        head = stream.peek(HEAD_BYTES)
        if len(head) < HEAD_BYTES:
            break
        length = HEAD_BYTES + int.from_bytes(head[1:], "little")
        if stream.at + length > stop:
            break
        if head[0] in (SCHEMA, CHANNEL):
            definitions += stream.take(length)
        else:
            stream.pass_over(length)
    return bytes(definitions)
