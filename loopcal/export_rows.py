"""The readings of a recording as the rows of one table.

One row a reading, all channels merged in order of host time: counts as recorded, and the
value that the rig's gain, zero and offset give them. Rows are made a stretch at a time, so
that what is held beside the recording is small. Knows no format of file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.recording import Recording
from recordings.rig import Channel, parameters

ROWS = 100_000
"""Readings that are made into rows at a time, about."""

Column = np.ma.MaskedArray[Any, Any]


@dataclass(frozen=True, slots=True)
class Rows:
    """Some readings in order of time, columns of length n; masked where there is nothing.

    Attributes:
        channel: (n,) number of the channel in the rig.
        fixture: (n,) number of the dwell's fixture among the names, -1 for none.
        numbers: the other columns by name, (n,), or None where no row has any.
    """

    channel: NDArray[np.int64]
    fixture: NDArray[np.int64]
    numbers: Mapping[str, Column | None]


def value_of(channel: Channel, raw: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n,) counts as the rig understands them [rad or m]: gain (counts - zero_count) + offset.

    Counts of a channel that wraps are first taken within half a turn of its zero.
    """
    counts = raw.astype(np.float64) - channel.zero_count
    if channel.modulus_counts is not None:
        half = channel.modulus_counts / 2
        counts = (counts + half) % channel.modulus_counts - half
    value: NDArray[np.float64] = channel.gain.nominal * counts + channel.offset.nominal
    return value


def rows(recording: Recording) -> Iterator[Rows]:
    """The readings of all channels in order of host time; equal times in the rig's order."""
    found = list(recording.readings.values())
    times = [readings.time_ns for readings in found]
    done = [0] * len(found)
    while any(at < len(time) for at, time in zip(done, times, strict=True)):
        end_ns = _stretch_end(times, done)
        upto = [int(np.searchsorted(time, end_ns, side="right")) for time in times]
        parts = [slice(first, end) for first, end in zip(done, upto, strict=True)]
        done = upto
        yield _rows(recording, parts)


def _rows(recording: Recording, parts: list[slice]) -> Rows:
    """The rows of one part of each channel."""
    found = [(r, part) for r, part in zip(recording.readings.values(), parts, strict=True)]
    lengths = [part.stop - part.start for part in parts]
    time_ns = np.concatenate([readings.time_ns[part] for readings, part in found])
    order = np.argsort(time_ns, kind="stable")
    time_ns = time_ns[order]
    dwell = _dwell_of(recording, time_ns)
    numbers: dict[str, Column | None] = {"time_ns": np.ma.asarray(time_ns)}
    for name, attribute in (
        ("raw_counts", "raw"),
        ("flags", "flags"),
        ("device_time_ns", "device_time_ns"),
        ("sequence", "sequence"),
    ):
        given = [(getattr(readings, attribute), part) for readings, part in found]
        own = [None if values is None else values[part] for values, part in given]
        numbers[name] = _merged(own, lengths, order)
    values = [
        value_of(channel, readings.raw[part])
        for channel, (readings, part) in zip(recording.rig.channels, found, strict=True)
    ]
    columns = _value_columns(recording)
    for name in ("value_rad", "value_m"):
        shown = [v if name == c else None for v, c in zip(values, columns, strict=True)]
        numbers[name] = _merged(shown, lengths, order)
    for name in ("pose", "visit"):
        stated = np.array([getattr(d, name) for d in recording.dwells] or [0])
        numbers[name] = np.ma.array(stated[dwell], mask=dwell < 0)
    number = np.repeat(np.arange(len(found)), lengths)
    return Rows(number[order], _fixture_of(recording, dwell), numbers)


def _value_columns(recording: Recording) -> list[str]:
    """The column for the value of each channel."""
    dimension = {p.name: p.dimension for p in parameters(recording.rig)}
    turns = [dimension[f"{channel.name}.offset"] == "angle" for channel in recording.rig.channels]
    return ["value_rad" if turn else "value_m" for turn in turns]


def _stretch_end(times: Sequence[NDArray[np.int64]], done: Sequence[int]) -> int:
    """A time by which about `ROWS` more readings have come, of the channel that is busiest at most."""
    share = max(1, ROWS // len(times))
    ends = [
        int(time[min(at + share, len(time)) - 1])
        for at, time in zip(done, times, strict=True)
        if at < len(time)
    ]
    return min(ends)


def _merged(
    values: list[NDArray[Any] | None], lengths: list[int], order: NDArray[np.intp]
) -> Column | None:
    """``values`` of the channels in ``order``, masked where a channel has none; None where all have none."""
    kinds = [column.dtype for column in values if column is not None]
    if not kinds:
        return None
    filled = [
        np.zeros(length, kinds[0]) if column is None else column
        for column, length in zip(values, lengths, strict=True)
    ]
    missing = np.repeat([column is None for column in values], lengths)
    return np.ma.array(np.concatenate(filled)[order], mask=missing[order])


def _dwell_of(recording: Recording, time_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """(n,) number of the dwell in which each time lies, the last begun of several; -1 for none."""
    dwell = np.full(len(time_ns), -1, np.intp)
    for number in sorted(range(len(recording.dwells)), key=lambda n: recording.dwells[n].start_ns):
        found = recording.dwells[number]
        first, end = np.searchsorted(time_ns, [found.start_ns, found.end_ns + 1])
        dwell[first:end] = number
    return dwell


def fixtures(recording: Recording) -> list[str]:
    """Names of the fixtures in which dwells were held."""
    return sorted({dwell.fixture for dwell in recording.dwells if dwell.fixture is not None})


def _fixture_of(recording: Recording, dwell: NDArray[np.intp]) -> NDArray[np.int64]:
    names = fixtures(recording)
    own = [-1 if d.fixture is None else names.index(d.fixture) for d in recording.dwells]
    return np.array([*own, -1])[dwell]  # -1, no dwell, is the last
