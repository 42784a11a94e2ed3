"""Blocks of records as arrays: which messages they hold, and what the readings among them say.

Owns the step from bytes to columns without a Python loop over messages. Readings of one
channel that are all written alike are taken as arrays; any other is left to protobuf, so
that the result is the same for every way of writing the same messages. Pure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from recordings import messages_pb2
from recordings.offsets import HEAD_BYTES
from recordings.wire import FIELDS, HEADER_SIZE, MESSAGE_OPCODE, Layout, layouts_of, unaligned


@dataclass(frozen=True, slots=True)
class Messages:
    """Message records of a block.

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

    def __len__(self) -> int:
        return len(self.start)

    def take(self, rows: NDArray[Any] | slice) -> Messages:
        """Some of the messages, by index, mask or slice."""
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

    def by_channel(self) -> Iterator[tuple[int, Messages]]:
        """The messages of each MCAP channel, in their order."""
        for channel_id in np.flatnonzero(np.bincount(self.channel_id)).tolist():
            yield channel_id, self.take(np.flatnonzero(self.channel_id == channel_id))


def messages(data: bytes, offsets: NDArray[np.int64]) -> Messages:
    """The messages among the records at ``offsets``; those too short to be one are left out."""
    size = unaligned(data, "<i8", 1)[offsets] - (HEADER_SIZE - HEAD_BYTES)
    opcode = np.frombuffer(data, np.uint8)[offsets]
    kept = (opcode == MESSAGE_OPCODE) & (size >= 0)
    if not kept.all():
        offsets, size = offsets[kept], size[kept]
    return Messages(
        data=data,
        channel_id=unaligned(data, "<u2", 9)[offsets],
        time_ns=unaligned(data, "<i8", 15)[offsets],
        start=offsets + HEADER_SIZE,
        size=size,
    )


@dataclass(frozen=True, slots=True)
class Columns:
    """Readings of one channel in the order of the file, columns of equal length.

    Attributes:
        time_ns, raw, flags: (n,) log_time, counts, and bits, 0 where a reading has none.
        device_time_ns, sequence: (n,), or None where any reading lacks it.
    """

    time_ns: NDArray[np.int64]
    raw: NDArray[np.int64]
    device_time_ns: NDArray[np.int64] | None
    sequence: NDArray[np.uint32] | None
    flags: NDArray[np.uint32]


def decode_readings(found: Messages) -> tuple[Columns, int]:
    """Decode messages that are all readings of one channel.

    Returns:
        What the readable ones say, and how many are no readings, or have no raw count.
    """
    size = int(found.size[0]) if len(found) else 0
    if np.all(found.size == size):
        for layout in layouts_of(size):
            # Whole records first, one behind the other: their fields are then near each other.
            span = layout.record.itemsize
            rows = unaligned(found.data, f"V{span}")[found.start - HEADER_SIZE].view(layout.record)
            if all(np.all(rows[f"{name}_tag"] == tag) for name, tag in layout.tags):
                return _alike(found.time_ns, rows, layout), 0
    return _mixed(found)


def _alike(time_ns: NDArray[np.int64], rows: NDArray[np.void], layout: Layout) -> Columns:
    """Readings that have exactly the fields of ``layout``."""
    values = {name: rows[name].copy() for name in layout.present}
    flags = values.get("flags")
    return Columns(
        time_ns=time_ns,
        raw=values["raw"],
        device_time_ns=values.get("device_time_ns"),
        sequence=values.get("sequence"),
        flags=np.zeros(len(rows), np.uint32) if flags is None else flags,
    )


def _mixed(found: Messages) -> tuple[Columns, int]:
    """Readings each written in its own way: by layout where they have one, else by protobuf."""
    count = len(found)
    values = {name: np.zeros(count, kind) for name, _, kind in FIELDS}
    present = {name: np.zeros(count, np.bool_) for name, _, _ in FIELDS}
    view = np.frombuffer(found.data, np.uint8)
    left = np.arange(count)
    for size in np.unique(found.size).tolist():
        for layout in layouts_of(size):
            rows = left[found.size[left] == size]
            for name, tag in layout.tags:
                tags = view[found.start[rows] + layout.values[name] - 1]
                rows = rows[tags == tag]
            for name, place in layout.values.items():
                kind = values[name].dtype.str
                values[name][rows] = unaligned(found.data, kind, place)[found.start[rows]]
                present[name][rows] = True
            left = np.setdiff1d(left, rows, assume_unique=True)
    for row in left.tolist():
        _decode_one(found.payload(row), row, values, present)
    readable = present["raw"]
    complete = {name: bool(present[name][readable].all()) for name in present}
    return Columns(
        time_ns=found.time_ns[readable],
        raw=values["raw"][readable],
        device_time_ns=values["device_time_ns"][readable] if complete["device_time_ns"] else None,
        sequence=values["sequence"][readable] if complete["sequence"] else None,
        flags=values["flags"][readable],
    ), count - int(readable.sum())


def _decode_one(
    payload: bytes,
    row: int,
    values: dict[str, NDArray[Any]],
    present: dict[str, NDArray[np.bool_]],
) -> None:
    """Decode one reading by protobuf; of what is none, nothing is present."""
    message = messages_pb2.Reading()
    try:
        message.ParseFromString(payload)
    except DecodeError:
        return
    for name, _, _ in FIELDS:
        if message.HasField(name):
            values[name][row] = getattr(message, name)
            present[name][row] = True
