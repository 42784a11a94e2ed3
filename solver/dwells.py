"""Finding where the mechanism stood still, from the readings alone.

A channel moves where the mean of the samples just after a moment differs from the mean of
those just before by more than noise allows; the noise is taken from the recording itself.
Standstill is where no channel moves, for long enough. Used when a recording carries no
dwell messages, and to find those in which the mechanism still moved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]

_HALF_WINDOW_S = 0.15
_GRID_S = 0.01
EDGE_S = 0.08  # at either end of a standstill motion may already have begun, below the noise
_THRESHOLD = 5.0  # standard errors of the difference of two half-window means
_FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
_PEAKED = 0.3
_QUANTUM = 0.3  # counts: no channel is believed to be quieter than its quantisation


@dataclass(frozen=True, slots=True)
class Window:
    """A stretch of time [start_ns, end_ns] in which nothing moved: pose, visit, and fixture if known."""

    start_ns: int
    end_ns: int
    pose: int
    visit: int
    fixture: str | None = None


@dataclass(frozen=True, slots=True)
class Track:
    """One channel over the session: arrival times (S,) [ns], ascending, and counts (S,)."""

    time_ns: Times
    counts: Array


def noise(track: Track) -> float:
    """Standard deviation of one sample [counts] while nothing moves.

    From second differences, which are blind to steady motion, at their lower quartile over
    short stretches, which is blind to the rest of the motion.
    """
    second = np.diff(track.counts, n=2)
    length = 10
    if len(second) < length:
        return _QUANTUM
    stretches = second[: len(second) // length * length].reshape(-1, length)
    # var(second difference) = 6 var(sample); the quartile of a mean of 10 squares sits near 0.7 of its mean.
    spread = np.quantile(np.mean(stretches**2, axis=1), 0.25) / 0.7
    return max(float(np.sqrt(spread / 6.0)), _QUANTUM)


def standstills(tracks: Mapping[str, Track], *, shortest_s: float) -> tuple[Window, ...]:
    """Windows in which every channel stood still for at least ``shortest_s``.

    Each window is a pose of its own; nothing here can know that a pose was visited again.
    """
    usable = [track for track in tracks.values() if len(track.time_ns) >= 4]
    if not usable or len(usable) < len(tracks):
        return ()
    start = max(int(track.time_ns[0]) for track in usable)
    end = min(int(track.time_ns[-1]) for track in usable)
    grid = np.arange(start, end, int(_GRID_S * 1e9), dtype=np.int64)
    if len(grid) == 0:
        return ()
    still = np.ones(len(grid), dtype=bool)
    for track in usable:
        still &= _still(track, grid, noise(track))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    windows: list[Window] = []
    for first, last in edges.reshape(-1, 2):
        if (last - 1 - first) * _GRID_S >= shortest_s:
            windows.append(Window(int(grid[first]), int(grid[last - 1]), len(windows), 0))
    return tuple(windows)


def _still(track: Track, grid: Times, sigma: float) -> NDArray[np.bool_]:
    """Whether the channel stands still around each time of ``grid`` (G,)."""
    half = int(_HALF_WINDOW_S * 1e9)
    sums = np.concatenate([[0.0], np.cumsum(track.counts - track.counts[0])])
    left, here, right = (np.searchsorted(track.time_ns, grid + shift) for shift in (-half, 0, half))
    before, after = here - left, right - here
    counted = (before > 0) & (after > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = (sums[right] - sums[here]) / after - (sums[here] - sums[left]) / before
        error = sigma * np.sqrt(1.0 / before + 1.0 / after)
    error = error * _alike(np.abs(difference[counted]) / error[counted])
    return counted & (
        np.abs(np.where(counted, difference, np.inf)) < _THRESHOLD * np.where(counted, error, 1.0)
    )


def _alike(apart: NDArray[np.float64]) -> float:
    """By how much means differ more than white noise says, since neighbouring samples are alike.

    ``apart`` are differences of neighbouring means in its standard errors, at rest and in motion.
    Those near zero are at rest; of a normal distribution, two fifths of what lies within 2.5 standard
    deviations lie within half of one, and of one that is much wider only a fifth.
    """
    for factor in _FACTORS:
        near = np.count_nonzero(apart < 2.5 * factor)
        if near and np.count_nonzero(apart < 0.5 * factor) > _PEAKED * near:
            return factor
    return 1.0


def without_edges(windows: Sequence[Window], margin_s: float) -> tuple[Window, ...]:
    """The windows, each shortened by ``margin_s`` at both ends; those that vanish are dropped."""
    margin = int(margin_s * 1e9)
    return tuple(
        Window(w.start_ns + margin, w.end_ns - margin, w.pose, w.visit)
        for w in windows
        if w.end_ns - w.start_ns > 2 * margin
    )
