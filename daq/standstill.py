"""Whether a mechanism stands still, judged from the noise of its own channels.

A channel stands still over a window when neither its drift nor its spread stands out of
its noise. With n samples of standard deviation sigma, the end-to-end change of a straight
line fitted to pure noise has the standard deviation sigma sqrt(12 / n), and the sample
standard deviation scatters about sigma by sigma / sqrt(2 (n - 1)); both tests allow
`CONFIDENCE` standard deviations.

sigma is the larger of what the rig says and what the window itself shows by successive
differences (von Neumann): these see noise and hardly any motion. Against vibration, which
they do see, the shown noise counts up to `NOISIER` times the stated one.

Pure: arrays in, verdict out. Refuses to know where samples come from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 4.0
"""Standard deviations that noise may reach: one false alarm in about 16,000 windows."""

NOISIER = 4.0
"""How many times noisier than the rig says a channel is believed to be."""

QUANTISATION = 1.0 / math.sqrt(12.0)
"""Standard deviation of rounding to whole counts."""

FEWEST = 5
"""Samples below which a window says nothing."""


@dataclass(frozen=True, slots=True)
class Window:
    """The latest samples of one channel.

    Attributes:
        time_ns: (n,) host arrival [ns].
        counts: (n,) unwrapped counts.
    """

    time_ns: NDArray[np.int64]
    counts: NDArray[np.int64]

    def since(self, time_ns: int) -> Window:
        """The samples that arrived at ``time_ns`` or later."""
        begin = int(np.searchsorted(self.time_ns, time_ns))
        return Window(self.time_ns[begin:], self.counts[begin:])

    def until(self, time_ns: int) -> Window:
        """The samples that arrived at ``time_ns`` or earlier."""
        end = int(np.searchsorted(self.time_ns, time_ns, side="right"))
        return Window(self.time_ns[:end], self.counts[:end])


def noise_of(window: Window, stated: float) -> float:
    """Standard deviation of one sample [counts], from the window and what the rig states.

    Args:
        window: at least two samples.
        stated: standard deviation that the rig expects [counts]; 0 where it says nothing.
    """
    steps = np.diff(window.counts).astype(np.float64)
    shown = math.sqrt(float(np.mean(steps * steps)) / 2.0)
    if stated > 0.0:
        shown = min(shown, NOISIER * stated)
    return math.hypot(max(stated, shown), QUANTISATION)


def stands_still(window: Window, stated: float) -> bool:
    """Whether neither drift nor spread of the window stands out of its noise.

    Args:
        window: samples of one channel; fewer than `FEWEST` are never still.
        stated: standard deviation of one sample that the rig expects [counts], or 0.
    """
    n = len(window.counts)
    if n < FEWEST:
        return False
    noise = noise_of(window, stated)
    counts = window.counts - window.counts[0].astype(np.float64)
    spread = float(np.std(counts, ddof=1))
    if spread > noise * (1.0 + CONFIDENCE / math.sqrt(2.0 * (n - 1))):
        return False
    time = (window.time_ns - window.time_ns[0]).astype(np.float64)
    span = time[-1]
    if span <= 0.0:
        return False
    centred = time - time.mean()
    drift = span * float(centred @ counts) / float(centred @ centred)
    return bool(abs(drift) <= CONFIDENCE * noise * math.sqrt(12.0 / n))


def moving(
    windows: Mapping[str, Window],
    stated: Mapping[str, float],
    since_ns: int,
    until_ns: int,
    gap_ns: int,
) -> tuple[str, ...]:
    """Channels that moved between ``since_ns`` and ``until_ns``, or of which it is not known.

    Args:
        windows: per channel, its samples; those outside the time asked about are left out.
        stated: per channel, the noise that the rig expects of one sample [counts].
        since_ns: begin of the time asked about.
        until_ns: its end.
        gap_ns: longest time without a sample before nothing is known of a channel.
    """
    return tuple(restless(windows, stated, since_ns, until_ns, gap_ns))


def restless(
    windows: Mapping[str, Window],
    stated: Mapping[str, float],
    since_ns: int,
    until_ns: int,
    gap_ns: int,
) -> Iterator[str]:
    """What `moving` gives, one by one: who wants to know only whether any moves asks for the first."""
    for name, window in windows.items():
        part = window.since(since_ns).until(until_ns)
        gaps = np.diff(part.time_ns, prepend=since_ns, append=until_ns)
        if int(gaps.max()) > gap_ns or not stands_still(part, stated[name]):
            yield name


def apart(
    before: Mapping[str, Window], now: Mapping[str, Window], stated: Mapping[str, float]
) -> bool:
    """Whether two standstills differ, in any channel, by more than noise explains.

    A channel with fewer than `FEWEST` samples now says nothing, and then neither does this.

    Args:
        before: per channel, the samples of one standstill.
        now: per channel, the samples of the other.
        stated: per channel, the noise that the rig expects of one sample [counts].
    """
    for name, window in now.items():
        if len(window.counts) < FEWEST:
            return False
        noise = max(noise_of(window, stated[name]), noise_of(before[name], stated[name]))
        if abs(float(window.counts.mean() - before[name].counts.mean())) > 2.0 * CONFIDENCE * noise:
            return True
    return False
