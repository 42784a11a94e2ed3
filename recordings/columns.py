"""Blocks of records as arrays: where the messages are, and what the readings among them say.

Owns the step from bytes to columns without a Python loop over messages. Where a block or a
message is irregular it falls back to walking the records and to protobuf, so that the
result is the same for every way of writing the same messages. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from recordings import messages_pb2
from recordings.wire import FIELDS, HEADER_SIZE, MESSAGE_OPCODE, layouts_of, unaligned

_HEAD = 9


def record_offsets(data: bytes) -> tuple[NDArray[np.int64], int]:
    """Where the records of a block begin.

    Returns:
        Offsets (n,), and the offset at which the records end: len(data), or less where the
        rest is not a whole record.
    """
    # A record of a block begins with opcode 3, 4 or 5 and its length. All bytes that look
    # like that are candidates; they are right if each ends where the next begins.
    view = np.frombuffer(data, np.uint8)
    places = np.flatnonzero(view[: max(0, len(data) - _HEAD + 1)] - np.uint8(3) < 3)
    length = unaligned(data, "<u8", 1)[places]
    fits = length <= (len(data) - _HEAD - places).astype(np.uint64)
    places = places[fits]
    ends = places + _HEAD + length[fits].astype(np.int64)
    if not _chained(places, ends, len(data)):
        # Some bytes inside messages look like records. Few of them end at another candidate.
        marked = np.zeros(len(data) + 1, np.bool_)
        marked[places] = marked[-1] = True
        places, ends = places[marked[ends]], ends[marked[ends]]
        if not _chained(places, ends, len(data)):
            return _walk(data)
    return places, len(data)


def _chained(places: NDArray[np.int64], ends: NDArray[np.int64], size: int) -> bool:
    if len(places) == 0:
        return size == 0
    return bool(places[0] == 0 and ends[-1] == size and np.array_equal(places[1:], ends[:-1]))


def _walk(data: bytes) -> tuple[NDArray[np.int64], int]:
    offsets = []
    at = 0
    while at + _HEAD <= len(data):
        end = at + _HEAD + int.from_bytes(data[at + 1 : at + _HEAD], "little")
        if end > len(data):
            break
        offsets.append(at)
        at = end
    return np.array(offsets, np.int64), at


@dataclass(frozen=True, slots=True)
class Messages:
    """The Message records of a block.

    Attributes:
        data: the block.
        channel_id: (n,) MCAP channel.
        time_ns: (n,) log_time.
        start: (n,) offset of the payload in ``data``.
        size: (n,) bytes of the payload.
    """

    data: bytes
    channel_id: NDArray[np.uint16]
    time_ns: NDArray[np.int64]
    start: NDArray[np.int64]
    size: NDArray[np.int64]

    def take(self, rows: NDArray[Any]) -> Messages:
        """Some of the messages, by index or mask."""
        return Messages(
            self.data,
            self.channel_id[rows],
            self.time_ns[rows],
            self.start[rows],
            self.size[rows],
        )

    def payload(self, row: int) -> bytes:
        """One message's payload."""
        start = int(self.start[row])
        return self.data[start : start + int(self.size[row])]


def messages(data: bytes, offsets: NDArray[np.int64]) -> Messages:
    """The messages among the records at ``offsets``; those too short to be one are left out."""
    size = unaligned(data, "<u8", 1)[offsets].astype(np.int64) - (HEADER_SIZE - _HEAD)
    opcode = np.frombuffer(data, np.uint8)[offsets]
    offsets, size = (values[(opcode == MESSAGE_OPCODE) & (size >= 0)] for values in (offsets, size))
    return Messages(
        data=data,
        channel_id=unaligned(data, "<u2", 9)[offsets],
        time_ns=unaligned(data, "<i8", 15)[offsets],
        start=offsets + HEADER_SIZE,
        size=size,
    )


@dataclass(frozen=True, slots=True)
class Columns:
    """What readings say, in columns of equal length; where a field is absent it is 0.

    Attributes:
        values: field name -> (n,) values.
        present: field name -> (n,) whether the reading has the field.
        readable: (n,) whether it is a reading at all, with a raw count.
    """

    values: dict[str, NDArray[Any]]
    present: dict[str, NDArray[np.bool_]]
    readable: NDArray[np.bool_]


def decode_readings(found: Messages) -> Columns:
    """Decode messages that are all readings."""
    count = len(found.start)
    values = {name: np.zeros(count, kind) for name, _, kind in FIELDS}
    present = {name: np.zeros(count, np.bool_) for name, _, _ in FIELDS}
    readable = np.zeros(count, np.bool_)
    view = np.frombuffer(found.data, np.uint8)
    for size in np.unique(found.size).tolist():
        rows = np.flatnonzero(found.size == size)
        for layout in layouts_of(size):
            start = found.start[rows]
            fits = np.ones(len(rows), np.bool_)
            for place, tag in layout.tags:
                fits &= view[start + place] == tag
            start, regular = start[fits], rows[fits]
            for name, _, kind in FIELDS:
                if name in layout.values:
                    place = layout.values[name]
                    values[name][regular] = unaligned(found.data, kind, place)[start]
                    present[name][regular] = True
            readable[regular] = True
            rows = rows[~fits]
        for row in rows.tolist():
            readable[row] = _decode_one(found.payload(row), row, values, present)
    return Columns(values, present, readable)


def _decode_one(
    payload: bytes,
    row: int,
    values: dict[str, NDArray[Any]],
    present: dict[str, NDArray[np.bool_]],
) -> bool:
    """Decode one reading by protobuf; returns whether it is one."""
    message = messages_pb2.Reading()
    try:
        message.ParseFromString(payload)
    except DecodeError:
        return False
    for name, _, _ in FIELDS:
        if message.HasField(name):
            values[name][row] = getattr(message, name)
            present[name][row] = True
    return message.HasField("raw")
