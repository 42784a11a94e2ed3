"""Columns that grow: what was decoded of one channel, part by part, in one piece of memory.

Owns how readings are held while a file is read: a column costs its own bytes and little
more, however many parts it came in. A column that would hold nothing but zeros (flags) or
that some reading lacks is not held at all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.columns import Columns
from recordings.recording import Readings

_FEWEST = 1024
_GROWTH = 1.5


class _Growing:
    """One column."""

    def __init__(self, kind: str) -> None:
        self._values: NDArray[Any] = np.empty(_FEWEST, kind)

    def put(self, at: int, values: NDArray[Any]) -> None:
        """Set the values from row ``at`` on."""
        end = at + len(values)
        if end > len(self._values):
            grown = np.empty(max(end, int(_GROWTH * len(self._values))), self._values.dtype)
            grown[:at] = self._values[:at]
            self._values = grown
        self._values[at:end] = values

    def first(self, count: int) -> NDArray[Any]:
        """The first ``count`` values."""
        return self._values[:count]


class Gathered:
    """The readings of one channel so far, in file order."""

    def __init__(self) -> None:
        self._count = 0
        self._sorted = True
        self._last_ns = 0
        self._time_ns = _Growing("<i8")
        self._raw = _Growing("<i8")
        self._device_time_ns: _Growing | None = _Growing("<i8")
        self._sequence: _Growing | None = _Growing("<u4")
        self._flags: _Growing | None = None

    def append(self, part: Columns) -> None:
        """Put ``part`` behind what there is."""
        if len(part.time_ns) == 0:
            return
        at = self._count
        time_ns = part.time_ns
        self._sorted = (
            self._sorted
            and bool(time_ns[0] >= self._last_ns)
            and not np.any(time_ns[1:] < time_ns[:-1])
        )
        self._last_ns = int(time_ns[-1])
        self._time_ns.put(at, time_ns)
        self._raw.put(at, part.raw)
        self._device_time_ns = _put(self._device_time_ns, at, part.device_time_ns)
        self._sequence = _put(self._sequence, at, part.sequence)
        if self._flags is None and part.flags.any():
            self._flags = _Growing("<u4")
            self._flags.put(0, np.zeros(at, np.uint32))
        if self._flags is not None:
            self._flags.put(at, part.flags)
        self._count = at + len(time_ns)

    def readings(self, channel: str) -> Readings:
        """All readings, sorted by time and read-only; call it once."""
        count = self._count
        time_ns = self._time_ns.first(count)
        order = None if self._sorted else np.argsort(time_ns, kind="stable")
        some = count > 0
        return Readings(
            channel=channel,
            time_ns=_final(time_ns, order),
            raw=_final(self._raw.first(count), order),
            device_time_ns=self._whole(self._device_time_ns, order) if some else None,
            sequence=self._whole(self._sequence, order) if some else None,
            flags=_final(self._flag_bits(), order),
        )

    def _whole(
        self, column: _Growing | None, order: NDArray[np.intp] | None
    ) -> NDArray[Any] | None:
        return None if column is None else _final(column.first(self._count), order)

    def _flag_bits(self) -> NDArray[np.uint32]:
        if self._flags is None:
            return np.zeros(self._count, np.uint32)  # zeros that nobody writes take no memory
        return self._flags.first(self._count)


def _final(column: NDArray[Any], order: NDArray[np.intp] | None) -> NDArray[Any]:
    """``column`` in ``order``, read-only."""
    final = column if order is None else column[order]
    final.flags.writeable = False
    return final


def _put(column: _Growing | None, at: int, values: NDArray[Any] | None) -> _Growing | None:
    """``column`` with ``values`` from row ``at`` on; None where either is lacking."""
    if column is None or values is None:
        return None
    column.put(at, values)
    return column
