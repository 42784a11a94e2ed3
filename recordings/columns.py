"""Blocks of records as arrays: which messages they hold, and what the readings among them say.

Owns the step from bytes to columns without a Python loop over messages. Readings of one
channel that are all written alike are taken as arrays; any other is left to protobuf, so
that the result is the same for every way of writing the same messages. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from recordings import messages_pb2
from recordings.records import HEAD_BYTES, MESSAGE
from recordings.wire import FIELDS, HEADER_SIZE, Layout, layouts_of, unaligned


@dataclass(frozen=True, slots=True)
class Messages:
    """Message records of a block.

    Attributes:
        data: the block.
        channel_id: (n,) MCAP channel.
        start: (n,) offset of the payload in ``data``.
        size: (n,) bytes of the payload.
    """

    data: bytes
    channel_id: NDArray[np.uint16]
    start: NDArray[np.int64]
    size: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    def time_ns(self) -> NDArray[np.int64]:
        """(n,) log_time."""
        return self._head("<i8", 15)

    def sequence(self) -> NDArray[np.uint32]:
        """(n,) MCAP sequence number."""
        return self._head("<u4", 11)

    def _head(self, kind: str, place: int) -> NDArray[Any]:
        return unaligned(self.data, kind, place)[self.start - HEADER_SIZE]

    def take(self, rows: NDArray[Any] | slice) -> Messages:
        """Some of the messages, by index, mask or slice."""
        return Messages(self.data, self.channel_id[rows], self.start[rows], self.size[rows])

    def payload(self, row: int) -> bytes:
        """One message's payload."""
        start = int(self.start[row])
        return self.data[start : start + int(self.size[row])]

    def by_channel(self) -> tuple[Messages, list[tuple[int, slice]]]:
        """The messages sorted by MCAP channel, else in their order; each channel, and where its are."""
        if len(self) == 0:
            return self, []
        grouped = self.take(np.argsort(self.channel_id, kind="stable"))
        ids = grouped.channel_id
        firsts = [0, *(np.flatnonzero(ids[1:] != ids[:-1]) + 1).tolist(), len(ids)]
        return grouped, [(int(ids[at]), slice(at, behind)) for at, behind in pairwise(firsts)]


def messages(data: bytes, offsets: NDArray[np.int64]) -> Messages:
    """The messages among the records at ``offsets``; those too short to be one are left out."""
    opcode = np.frombuffer(data, np.uint8)[offsets]
    size = unaligned(data, "<i8", 1)[offsets] - (HEADER_SIZE - HEAD_BYTES)
    kept = (opcode == MESSAGE) & (size >= 0)
    if not kept.all():
        offsets, size = offsets[kept], size[kept]
    return Messages(data, unaligned(data, "<u2", 9)[offsets], offsets + HEADER_SIZE, size)


@dataclass(frozen=True, slots=True)
class Columns:
    """Readings in the order of the file, columns of equal length.

    Attributes:
        time_ns, raw, flags: (n,) log_time, counts, and bits, 0 where a reading has none.
        device_time_ns, sequence: (n,), or None where any reading lacks it.
    """

    time_ns: NDArray[np.int64]
    raw: NDArray[np.int64]
    device_time_ns: NDArray[np.int64] | None
    sequence: NDArray[np.uint32] | None
    flags: NDArray[np.uint32]

    def take(self, rows: NDArray[Any] | slice) -> Columns:
        """Some of the readings, by index, mask or slice."""
        return Columns(
            time_ns=self.time_ns[rows],
            raw=self.raw[rows],
            device_time_ns=None if self.device_time_ns is None else self.device_time_ns[rows],
            sequence=None if self.sequence is None else self.sequence[rows],
            flags=self.flags[rows],
        )


def decode_readings(found: Messages) -> tuple[Columns, int]:
    """Decode messages that are all readings of one channel.

    Returns:
        What the readable ones say, and how many are no readings, or have no raw count.
    """
    alike = decode_alike(found)
    return _mixed(found) if alike is None else (alike, 0)


def decode_alike(found: Messages) -> Columns | None:
    """Decode readings, of any channels, that all have the same fields; None where they have not."""
    size = int(found.size[0]) if len(found) else 0
    if not (found.size == size).all():
        return None
    for layout in layouts_of(size):
        # Whole records first, one behind the other: their fields are then near each other.
        span = layout.record.itemsize
        rows = unaligned(found.data, f"V{span}")[found.start - HEADER_SIZE].view(layout.record)
        if all((rows[f"{name}_tag"] == tag).all() for name, tag in layout.tags):
            return _columns(rows, layout)
    return None


def _columns(rows: NDArray[np.void], layout: Layout) -> Columns:
    """What records of ``layout`` say; views of them."""
    values = {name: rows[name] for name in layout.present}
    return Columns(
        time_ns=rows["log_time"].view(np.int64),
        raw=values["raw"],
        device_time_ns=values.get("device_time_ns"),
        sequence=values.get("sequence"),
        flags=values.get("flags", np.zeros(len(rows), np.uint32)),
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
        time_ns=found.time_ns()[readable],
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
