"""Readings in motion: rows between the dwells, for what only motion shows (a lag).

In every move between two dwells a few instants are chosen, spread over the way gone. Each channel
is read there by a cubic through its nearest samples, at times on one clock (`solver.times`): without
the jitter of transport, and without what is known of the skew between devices. A constant
difference of transport that nobody measured stays: to the model it is a lag of their channels.
Instants where a channel moves less smoothly than a cubic are left out.

Owns rows in motion only; dwells are the business of `solver.samples`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from recordings.reader import Recording
from solver.dwells import Window
from solver.mechanism.circumstances import Circumstances
from solver.samples import PoseTable, track
from solver.times import taken

Array = NDArray[np.float64]

_SHARES = np.array([0.35, 0.65])  # of the way of a move, at which it is read
_HALF = 4  # samples on either side of an instant
_DEGREE = 3
_GAP = 3.5  # usual intervals between two samples: more were lost than a cubic may bridge
_ROUGH = 3.0  # times the noise: what a cubic may leave in a smooth motion
_LEAST_NOISE = 0.29  # counts: rounding alone
_STILL = 20.0  # standard deviations of a sample that some channel must move between two dwells


@dataclass(frozen=True, slots=True)
class _Timed:
    """One channel with times [s since the session began] (S,), their uncertainty [s], and counts (S,)."""

    time_s: Array
    uncertainty_s: float
    counts: Array

    @property
    def interval_s(self) -> float:
        """Usual time between two samples [s]."""
        return float(np.median(np.diff(self.time_s)))


@dataclass(frozen=True, slots=True)
class _Row:
    """One instant: counts, their standard deviations, and speeds [counts/s], each (C,)."""

    counts: Array
    sigma: Array
    speed: Array


def with_motion(recording: Recording, table: PoseTable) -> tuple[PoseTable, Circumstances]:
    """``table`` with rows in motion behind its dwells, and the circumstances of all rows.

    Args:
        recording: what was captured.
        table: its dwells, averaged.

    Raises:
        NotEnoughData: a channel has no readings.
    """
    rig = recording.rig
    tracks = [track(recording, channel) for channel in rig.channels]
    times = [taken(recording, channel, table.start_ns) for channel in rig.channels]
    timed = [
        _Timed(when.time_s, when.uncertainty_s, samples.counts)
        for when, samples in zip(times, tracks, strict=True)
    ]
    noise = np.maximum(table.noise, _LEAST_NOISE)
    rows: list[_Row] = []
    windows: list[Window] = []
    number = max(window.pose for window in table.windows) + 1
    ordered = sorted(table.windows, key=lambda w: w.start_ns)
    for before, after in pairwise(ordered):
        if before.fixture != after.fixture:
            continue
        begin, end = ((t - table.start_ns) * 1e-9 for t in (before.end_ns, after.start_ns))
        for instant in _instants(timed, noise, begin, end):
            row = _read(timed, noise, instant, begin, end)
            if row is not None:
                at_ns = table.start_ns + round(instant * 1e9)
                windows.append(Window(at_ns, at_ns, number + len(rows), 0, before.fixture))
                rows.append(row)
    gains = np.array([channel.gain.nominal for channel in rig.channels])
    joined = _joined(table, rows, windows, gains)
    return joined, joined.circumstances(rig)


def _instants(timed: list[_Timed], noise: Array, begin: float, end: float) -> Array:
    """Times at which given shares of the way from ``begin`` to ``end`` [s] are gone; none where nothing moves."""
    grid = np.linspace(begin, end, 201)
    path = np.zeros(len(grid) - 1)
    moved = 0.0
    for channel, still in zip(timed, noise, strict=True):
        counts = np.interp(grid, channel.time_s, channel.counts)
        moved = max(moved, float(np.ptp(counts)) / still)
        path += np.abs(np.diff(counts)) / max(float(np.ptp(channel.counts)), 1.0)
    if end <= begin or moved < _STILL:
        return np.zeros(0)
    gone = np.concatenate([[0.0], np.cumsum(path)])
    instants = np.interp(_SHARES * gone[-1], gone, grid)
    interval = max(channel.interval_s for channel in timed)
    if np.diff(instants).min() < 2 * _HALF * interval:  # they would share samples
        instants = np.interp([0.5 * gone[-1]], gone, grid)
    return np.asarray(instants, dtype=np.float64)


def _read(
    timed: list[_Timed], noise: Array, instant: float, begin: float, end: float
) -> _Row | None:
    """All channels at one ``instant`` [s]; None where samples are missing or the motion is not smooth."""
    out = np.zeros((3, len(timed)))
    for c, channel in enumerate(timed):
        middle = int(np.searchsorted(channel.time_s, instant))
        part = slice(middle - _HALF, middle + _HALF)
        times = channel.time_s[max(part.start, 0) : part.stop] - instant
        counts = channel.counts[max(part.start, 0) : part.stop]
        if len(times) < 2 * _HALF or times[0] + instant < begin or times[-1] + instant > end:
            return None
        if np.diff(times).max() > _GAP * channel.interval_s:
            return None
        scale = float(np.abs(times).max())
        powers = np.vander(times / scale, _DEGREE + 1, increasing=True)
        inverse = np.linalg.pinv(powers)
        series = inverse @ counts
        left = counts - powers @ series
        rough = np.sqrt(float(left @ left) / (len(times) - _DEGREE - 1))
        if rough > _ROUGH * noise[c]:
            return None
        speed = series[1] / scale
        own = noise[c] * float(np.linalg.norm(inverse[0]))
        out[:, c] = series[0], np.hypot(own, speed * channel.uncertainty_s), speed
    return _Row(*out)


def _joined(table: PoseTable, rows: list[_Row], windows: list[Window], gains: Array) -> PoseTable:
    """``table`` with ``rows`` behind its own."""
    still = np.zeros(table.counts.shape) if table.rate is None else table.rate
    if not rows:
        return replace(table, rate=still)
    counts, sigma, speed = (
        np.array([getattr(row, part) for row in rows]) for part in ("counts", "sigma", "speed")
    )
    rate = speed * gains
    ones = np.ones((len(rows), len(table.channels)))
    approach = None
    if table.approach is not None:
        approach = np.concatenate([table.approach, np.sign(speed)])  # in counts, as of dwells
    return replace(
        table,
        counts=np.concatenate([table.counts, counts]),
        sigma=np.concatenate([table.sigma, sigma]),
        samples=np.concatenate([table.samples, ones.astype(np.int64)]),
        effective=np.concatenate([table.effective, ones]),
        windows=(*table.windows, *windows),
        approach=approach,
        rate=np.concatenate([still, rate]),
    )
