"""Arrays of readings that a caller gives: checked, and as columns of the types on file."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recordings.errors import RecordingError

_RANGES = {
    "time_ns": (0, 2**63 - 1),
    "raw": (-(2**63), 2**63 - 1),
    "device_time_ns": (-(2**63), 2**63 - 1),
    "sequence": (0, 2**32 - 1),
    "flags": (0, 2**32 - 1),
}


def checked_columns(channel: str, given: dict[str, ArrayLike | None]) -> dict[str, NDArray[Any]]:
    """Columns of equal length for `recordings.wire.encode_rows`; flags are 0 where none are given.

    Args:
        channel: named in messages.
        given: values by name of the field, each (n,) integers, or None where absent.

    Raises:
        RecordingError: a value does not fit its field.
        ValueError: not one-dimensional integers of one length.
    """
    columns = {name: _column(name, values) for name, values in given.items() if values is not None}
    columns.setdefault("flags", np.zeros(len(columns["time_ns"]), np.uint32))
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns of '{channel}' differ in length: {lengths}")
    return columns


def _column(name: str, values: ArrayLike) -> NDArray[Any]:
    low, high = _RANGES[name]
    column = np.asarray(values)
    if column.ndim != 1 or (column.size and column.dtype.kind not in "iu"):
        raise ValueError(
            f"'{name}' has shape {column.shape} of {column.dtype}, expected a row of integers"
        )
    if column.size and (int(column.min()) < low or int(column.max()) > high):
        raise RecordingError(f"'{name}' has values outside {low} ... {high}")
    return column
