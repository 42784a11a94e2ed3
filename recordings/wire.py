"""Readings as bytes, one at a time and by the thousand.

A `loopcal.Reading` has fixed-width fields with explicit presence, so all readings of a
channel have one length and a fixed place for every value. This file owns that layout: as a
struct for one message and as a NumPy record for arrays of whole MCAP Message records
(opcode, length, channel id, sequence, log_time, publish_time, payload).

Its bytes are those that protobuf writes. What it reads it checks tag by tag, and leaves
every other way of writing the same message to protobuf.
"""

from __future__ import annotations

import itertools
import struct
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.records import MESSAGE

FIELDS: tuple[tuple[str, int, str], ...] = (
    ("raw", 0x09, "<i8"),
    ("device_time_ns", 0x11, "<i8"),
    ("sequence", 0x1D, "<u4"),
    ("flags", 0x25, "<u4"),
)
"""Name, protobuf tag byte and type of each field, in the order in which protobuf writes them."""

HEADER: tuple[tuple[str, str], ...] = (
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel_id", "<u2"),
    ("counter", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
)
"""An MCAP Message record up to its payload."""

HEADER_SIZE = 31

_STRUCTS = {
    (device_time, sequence): struct.Struct(
        "<Bq" + ("Bq" if device_time else "") + ("BI" if sequence else "") + "BI"
    )
    for device_time in (False, True)
    for sequence in (False, True)
}


def encode_reading(raw: int, device_time_ns: int | None, sequence: int | None, flags: int) -> bytes:
    """The payload of one reading; equal to protobuf's.

    Raises:
        struct.error: a number does not fit its field.
    """
    if device_time_ns is None:
        if sequence is None:
            return _STRUCTS[False, False].pack(0x09, raw, 0x25, flags)
        return _STRUCTS[False, True].pack(0x09, raw, 0x1D, sequence, 0x25, flags)
    if sequence is None:
        return _STRUCTS[True, False].pack(0x09, raw, 0x11, device_time_ns, 0x25, flags)
    return _STRUCTS[True, True].pack(0x09, raw, 0x11, device_time_ns, 0x1D, sequence, 0x25, flags)


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the fields of a reading lie when exactly ``present`` are given.

    Attributes:
        present: names of the fields, in file order.
        payload_size: bytes of one payload.
        record: NumPy type of one whole MCAP Message record; tags are named ``<field>_tag``.
        tags: (name, tag byte) of each field.
        values: name -> offset in the payload.
    """

    present: tuple[str, ...]
    payload_size: int
    record: np.dtype[np.void]
    tags: tuple[tuple[str, int], ...]
    values: dict[str, int]


@cache
def layout(present: tuple[str, ...]) -> Layout:
    """The layout of readings with the fields ``present`` (in file order)."""
    parts: list[tuple[str, str]] = list(HEADER)
    tags: list[tuple[str, int]] = []
    values: dict[str, int] = {}
    size = 0
    for name, tag, kind in FIELDS:
        if name in present:
            parts += [(f"{name}_tag", "u1"), (name, kind)]
            tags.append((name, tag))
            values[name] = size + 1
            size += 1 + np.dtype(kind).itemsize
    return Layout(present, size, np.dtype(parts), tuple(tags), values)


def _layouts_with_raw() -> dict[int, tuple[Layout, ...]]:
    optional = tuple(name for name, _, _ in FIELDS[1:])
    found: dict[int, tuple[Layout, ...]] = {}
    for count in range(len(optional), -1, -1):
        for rest in itertools.combinations(optional, count):
            each = layout(("raw", *rest))
            found[each.payload_size] = (*found.get(each.payload_size, ()), each)
    return found


_BY_SIZE = _layouts_with_raw()


def layouts_of(payload_size: int) -> tuple[Layout, ...]:
    """All layouts with ``raw`` whose payload has ``payload_size`` bytes."""
    return _BY_SIZE.get(payload_size, ())


def encode_rows(
    channel_id: int, counter: int, columns: dict[str, NDArray[Any]]
) -> NDArray[np.void]:
    """MCAP Message records of readings, ready to be written.

    Args:
        channel_id: MCAP channel id.
        counter: MCAP sequence of the first; counts on modulo 2**32.
        columns: ``time_ns``, and a column of equal length for each field that is present.

    Returns:
        shape (n,), of the record type of the layout.
    """
    shape = layout(tuple(name for name, _, _ in FIELDS if name in columns))
    time_ns = columns["time_ns"]
    rows = np.empty(len(time_ns), shape.record)
    rows["opcode"] = MESSAGE
    rows["length"] = shape.record.itemsize - 9
    rows["channel_id"] = channel_id
    rows["counter"] = (counter + np.arange(len(rows))) % 2**32
    rows["log_time"] = time_ns
    rows["publish_time"] = time_ns
    for name, tag, _ in FIELDS:
        if name in columns:
            rows[f"{name}_tag"] = tag
            rows[name] = columns[name]
    return rows


def unaligned(data: bytes, kind: str, shift: int = 0) -> NDArray[Any]:
    """The value of type ``kind`` at every byte of ``data``: item i starts at byte i + shift."""
    dtype = np.dtype(kind)
    count = len(data) - shift - dtype.itemsize + 1
    if count <= 0:
        return np.empty(0, dtype)
    return np.ndarray((count,), dtype, data, shift, (1,))
