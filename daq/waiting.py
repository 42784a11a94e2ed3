"""Readings of one channel that wait to be written, as columns. Pure.

Columns, because numbers cost the program less to keep than as many readings: what is alive when the
collector of garbage comes by makes it slow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from recordings.events import Reading, ReadingFlag


class Waiting:
    """Takes readings in their order, and gives them back in it."""

    def __init__(self) -> None:
        self._time_ns: list[int] = []
        self._raw: list[int] = []
        self._device_time_ns: list[int | None] = []
        self._sequence: list[int | None] = []
        self._flags: list[ReadingFlag] = []

    def __len__(self) -> int:
        return len(self._raw)

    def add(self, reading: Reading) -> None:
        """Take one more."""
        self._time_ns.append(reading.time_ns)
        self._raw.append(reading.raw)
        self._device_time_ns.append(reading.device_time_ns)
        self._sequence.append(reading.sequence)
        self._flags.append(reading.flags)

    def columns(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """How many readings that have the same fields follow each other, and their columns.

        The columns are named as the arguments of `recordings.writer.Writer.write_readings`.
        """
        first = 0
        while first < len(self):
            behind = min(_alike(self._device_time_ns, first), _alike(self._sequence, first))
            rows = slice(first, behind)
            flags = self._flags[rows]
            columns: dict[str, Any] = {
                "time_ns": self._time_ns[rows],
                "raw": self._raw[rows],
                "device_time_ns": _present(self._device_time_ns[rows]),
                "sequence": _present(self._sequence[rows]),
                "flags": None if flags.count(ReadingFlag.NONE) == len(flags) else flags,
            }
            yield behind - first, columns
            first = behind


def _alike(column: Sequence[int | None], first: int) -> int:
    """Up to where all values are there, or all are lacking, as the one at ``first``."""
    if column.count(None) in (0, len(column)):
        return len(column)
    lacks = column[first] is None
    return next(
        (row for row in range(first, len(column)) if (column[row] is None) != lacks), len(column)
    )


def _present(column: Sequence[int | None]) -> Sequence[int | None] | None:
    return None if column[0] is None else column
