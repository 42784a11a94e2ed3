"""Where the records of a block begin, found without walking from one to the next.

A block is a row of Schema, Channel and Message records. Where many in a row have one length, as
readings do, they are walked a row at a time. Else all bytes that look like the head of one are
candidates; they are right if each record ends where the next begins. Where that does not settle
it, the records are walked one by one, so that the result is always that of the walk. Pure.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from recordings.records import HEAD_BYTES
from recordings.wire import unaligned

_FIRST, _KINDS = 3, 3  # opcodes 3, 4 and 5
_SLICE = 1 << 18  # bytes looked at together: they and what is made of them stay in a cache


_LENGTH = struct.Struct("<Q")
_AHEAD = 1 << 16  # bytes in which equal lengths are looked for together
_FEWEST_BYTES = 1 << 10  # of a row, on average: below, candidates are found sooner
_FIRST_ROWS = 64  # rows from which that is judged


def record_offsets(data: bytes) -> tuple[NDArray[np.int64], int]:
    """Where the records of a block begin.

    Returns:
        Offsets (n,), and the offset at which the records end: len(data), or less where the
        rest is not a whole record.
    """
    if (found := _walk_rows(data)) is not None:
        return found
    places, ends = _candidates(data)
    if _agreeing(places, ends) == len(places) and _last(ends) == len(data):
        return places, len(data)
    return _walk(data)


def leading_bytes(data: bytes) -> int:
    """How many bytes at the start of ``data`` are whole records of a block.

    Not one too many; a few records too few where ``data`` ends inside one. 0 where the first
    is not whole, or not of a block.
    """
    places, ends = _candidates(data)
    count = _agreeing(places, ends)
    certain = int(ends[count - 1]) if count else 0
    return certain if 2 * certain > len(data) else _walk_loose(data)


def _walk_rows(data: bytes) -> tuple[NDArray[np.int64], int] | None:
    """As `record_offsets`; None where there are few records of one length in a row."""
    last = len(data) - HEAD_BYTES
    rows: list[tuple[int, int, int]] = []  # where it begins, how many records, bytes of each
    at = 0
    while at <= last:
        (length,) = _LENGTH.unpack_from(data, at + 1)
        span = HEAD_BYTES + length
        behind = at + span
        if behind > len(data):
            break
        count = 1
        if behind <= last and data[behind + 1 : behind + HEAD_BYTES] == data[at + 1 : at + 9]:
            fitting = min(len(data) - at, max(_AHEAD, span)) // span
            same = np.ndarray((fitting,), "<u8", data, at + 1, (span,)) == length
            count = fitting if same.all() else int(np.argmin(same))
        rows.append((at, count, span))
        at += count * span
        if len(rows) > _FIRST_ROWS and at < _FEWEST_BYTES * len(rows):
            return None
    start, count_of, span_of = np.array(rows, np.int64).reshape(-1, 3).T
    number = np.arange(count_of.sum()) - np.repeat(np.cumsum(count_of) - count_of, count_of)
    return np.repeat(start, count_of) + np.repeat(span_of, count_of) * number, at


def _candidates(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts and ends of all that could be records and end where another could begin."""
    view = np.frombuffer(data, np.uint8)
    found = [np.empty(0, np.int64)]
    for start in range(0, len(data) - HEAD_BYTES + 1, _SLICE):
        part = view[start : start + _SLICE + HEAD_BYTES - 1]
        # Opcode 3, 4 or 5, and small bytes 3 and 7 of the length: few other bytes look so.
        looks = part[: 1 - HEAD_BYTES] - np.uint8(_FIRST)
        looks |= part[4:-4]
        looks |= part[8:]
        found.append(np.flatnonzero(looks < _KINDS) + start)
    places = np.concatenate(found)
    length = unaligned(data, "<u8", 1)[places]
    fits = length <= (len(data) - HEAD_BYTES - places).astype(np.uint64)
    places = places[fits]
    ends = places + HEAD_BYTES + length[fits].astype(np.int64)
    if _agreeing(places, ends) < len(places):
        # Some bytes inside messages look like records. Few of them end at another candidate.
        marked = np.zeros(len(data) + 1, np.bool_)
        marked[places] = marked[-1] = True
        places, ends = places[marked[ends]], ends[marked[ends]]
    return places, ends


def _agreeing(places: NDArray[np.int64], ends: NDArray[np.int64]) -> int:
    """How many candidates, from the first on, each begin where the one before ends."""
    if len(places) == 0 or places[0] != 0:
        return 0
    broken = np.flatnonzero(places[1:] != ends[:-1])
    return int(broken[0]) + 1 if len(broken) else len(places)


def _last(ends: NDArray[np.int64]) -> int:
    return int(ends[-1]) if len(ends) else 0


def _walk(data: bytes) -> tuple[NDArray[np.int64], int]:
    offsets = []
    at = 0
    while at + HEAD_BYTES <= len(data):
        end = at + HEAD_BYTES + int.from_bytes(data[at + 1 : at + HEAD_BYTES], "little")
        if end > len(data):
            break
        offsets.append(at)
        at = end
    return np.array(offsets, np.int64), at


def _walk_loose(data: bytes) -> int:
    at = 0
    while at + HEAD_BYTES <= len(data) and 0 <= data[at] - _FIRST < _KINDS:
        end = at + HEAD_BYTES + int.from_bytes(data[at + 1 : at + HEAD_BYTES], "little")
        if end > len(data):
            break
        at = end
    return at
