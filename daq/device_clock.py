"""The clock of a device against the host's: offset, drift, and how well both are known. Pure.

Model: a reading taken at device time d arrives at the host time

    h = d + offset + drift (d - d0) + delay,        delay >= 0 with a floor,

where the delay has a shortest value, which one-way times cannot tell from the offset: what is
estimated is offset + shortest delay. Delays have a long tail and a sharp floor, so the floor is
followed and not the mean:

1. Of each block of `BLOCK_S` only the smallest h - d counts (minimum filtering), and of those
   minima over the last `BLOCKS` blocks the ones near a line of median slope (Theil-Sen): a block
   in which the host was busy all the time, or a garbled time, is left out.
2. The line below all minima with the least area (Moon, Skelly & Towsley, INFOCOM 1999) is the
   edge of their lower convex hull that spans the mean time: offset and drift.
3. Its uncertainty is that of a straight line through as many points with the scatter of the
   minima about it, wider than the hull deserves where delays have a density at their floor, and
   about right where they have none; `REACHED` of the scatter is added for the floor itself.
   Neighbouring minima that are alike (a busy spell, the teeth of a coarse clock) are worth fewer
   than they are: the scatter grows by sqrt((1 + r) / (1 - r)), r their correlation.

A device clock that counts in steps of Q (found as the greatest common divisor of the times that
it gave, at most `LONGEST_STEP_NS`: samples taken like clockwork have a divisor without being
rounded to it) is late by anything in [0, Q). Where samples fall anywhere between two steps, by
drift or by the host's unpunctuality, the line lies on those that are not late. Else Q/2 is
taken off, with an uncertainty of Q / sqrt(12). A step that comes or does not come within the time
T of the line leaves the drift uncertain by Q / (sqrt(3) T).

The line assumes a constant drift over a minute. A device whose time went back, or that
jumped by more than `JUMP_S` against the host's, has restarted: its clock is another one.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

SECOND = 1_000_000_000

BLOCK_S = 0.5
"""Time over which the least delayed reading is looked for [s]."""

BLOCKS = 120
"""Blocks through which the line is laid: one minute."""

FEWEST = 6
"""Blocks before anything is said."""

JUMP_S = 2.0
"""Change of h - d between two readings [s] that no queue explains."""

LONGEST_STEP_NS = 1_000_000
"""Longest step in which a device's clock is taken to count."""

FAR = 8.0
"""Standard deviations, of the median deviation, beyond which a block is left out."""

UNEVEN = 1.2
"""By how much more than evenly the minima scatter: disturbed blocks hold fewer good readings."""

DEVIATION = 1.4826
"""Standard deviation over median absolute deviation, of a normal distribution."""

TEETH = 1.5
"""Steps of a device's clock that the drift must pass for the line to lie on their lower ends."""

DITHERED = 0.2
"""Share of uneven intervals from which samples are taken to fall anywhere between two steps."""

REACHED = 0.5
"""How far from the floor the line may be, in scatters of the minima: delays can be rare there."""

MOST_ALIKE = 0.9
"""Largest correlation of neighbours that is believed."""

CONFIDENCE = 1.96
"""Standard deviations within which 95 % of a normal distribution lie."""


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """What is known of a device's clock at ``device_time_ns``.

    Attributes:
        device_time_ns: on the device's clock.
        offset_ns: host arrival minus device time then, of a reading that did not wait.
        uncertainty_ns: its standard uncertainty.
        drift: growth of the offset [s/s].
        drift_uncertainty: its standard uncertainty.
    """

    device_time_ns: int
    offset_ns: int
    uncertainty_ns: float
    drift: float
    drift_uncertainty: float


class DeviceClock:
    """Follows the clock of one device, reading by reading.

    Attributes:
        restarts: how often the device's clock began anew.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._begin()

    def _begin(self) -> None:
        self._blocks: deque[tuple[int, int]] = deque(maxlen=BLOCKS)
        self._best: tuple[int, int] | None = None
        self._block_ends_ns = 0
        self._last: tuple[int, int] | None = None
        self._step_ns = 0
        self._since_ns = 0
        self._steps = 0
        self._uneven = 0

    def add(self, device_time_ns: int, time_ns: int) -> bool:
        """A reading taken at ``device_time_ns`` came at ``time_ns``; whether a block is complete."""
        away_ns = time_ns - device_time_ns
        if self._last is not None:
            since_ns, jump_ns = device_time_ns - self._last[0], away_ns - self._last[1]
            if since_ns < 0 or abs(jump_ns) > JUMP_S * SECOND:
                self.restarts += 1
                self._begin()
            else:
                self._step_ns = math.gcd(self._step_ns, since_ns)
                self._steps += 1
                self._uneven += since_ns != self._since_ns
                self._since_ns = since_ns
        self._last = (device_time_ns, away_ns)
        complete = False
        if self._best is None or time_ns >= self._block_ends_ns:
            complete = self._best is not None
            if self._best is not None:
                self._blocks.append(self._best)
            self._best = (device_time_ns, away_ns)
            self._block_ends_ns = time_ns + round(BLOCK_S * SECOND)
        elif away_ns < self._best[1]:
            self._best = (device_time_ns, away_ns)
        return complete

    def estimate(self) -> ClockEstimate | None:
        """What the blocks so far tell of the clock now; None while there are too few."""
        if len(self._blocks) < FEWEST or self._last is None:
            return None
        first_ns, away_ns = self._blocks[0]
        time_s = np.array([(d - first_ns) / SECOND for d, _ in self._blocks])
        above_ns = np.array([float(y - away_ns) for _, y in self._blocks])
        kept = _near_a_line(time_s, above_ns)
        time_s, above_ns = time_s[kept], above_ns[kept]
        count = len(time_s)
        if count < FEWEST:
            return None
        middle_s = float(time_s.mean())
        span_s = float(np.ptp(time_s))
        spread = float(((time_s - middle_s) ** 2).sum())
        level, slope = _line_below(time_s - middle_s, above_ns)
        left = above_ns - level - slope * (time_s - middle_s)
        left = left - left.mean()
        scatter = math.sqrt(float(left @ left) / (count - 2)) * UNEVEN * _student(count - 2)
        scatter *= _alike(left)
        now_s = (self._last[0] - first_ns) / SECOND - middle_s
        step_ns = float(min(self._step_ns, LONGEST_STEP_NS))
        dithered = self._uneven > DITHERED * self._steps
        rounding = _rounding(step_ns, slope, span_s, dithered=dithered)
        statistical = scatter * math.sqrt(REACHED**2 + 1.0 / count + now_s**2 / spread)
        # The offset has the size of an epoch: a double does not hold its nanoseconds.
        offset_ns = away_ns + round(level + slope * now_s - rounding.late_ns)
        return ClockEstimate(
            device_time_ns=self._last[0],
            offset_ns=offset_ns,
            uncertainty_ns=math.hypot(
                statistical, rounding.uncertainty_ns, rounding.of_slope * now_s
            ),
            drift=slope / SECOND,
            drift_uncertainty=math.hypot(scatter / math.sqrt(spread), rounding.of_slope) / SECOND,
        )


@dataclass(frozen=True, slots=True)
class _Rounding:
    """What a clock that counts in steps does to the line: how late it seems, and how unsure [ns, ns/s]."""

    late_ns: float
    uncertainty_ns: float
    of_slope: float


def _rounding(step_ns: float, slope: float, span_s: float, *, dithered: bool) -> _Rounding:
    of_slope = step_ns / (math.sqrt(3.0) * span_s)
    if dithered or abs(slope) * span_s >= TEETH * step_ns:
        return _Rounding(0.0, step_ns / math.sqrt(12.0) / TEETH, of_slope)
    return _Rounding(step_ns / 2.0, step_ns / math.sqrt(12.0), of_slope)


def _line_below(time_s: NDArray[np.float64], above_ns: NDArray[np.float64]) -> tuple[float, float]:
    """Level at time 0 and slope of the line below all n points, of mean time 0, with the least area.

    It is the edge of the lower convex hull that spans time 0.
    """
    hull: list[tuple[float, float]] = []
    for point in sorted(zip(time_s.tolist(), above_ns.tolist(), strict=True)):
        while len(hull) > 1 and not _turns_up(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    for (t0, y0), (t1, y1) in pairwise(hull):
        if t1 >= 0.0 and t1 > t0:
            slope = (y1 - y0) / (t1 - t0)
            return y0 - slope * t0, slope
    return hull[-1][1], 0.0


def _turns_up(
    first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]
) -> bool:
    """Whether the way through three points, in order of time, turns to the left."""
    (t0, y0), (t1, y1), (t2, y2) = first, second, third
    return (t1 - t0) * (y2 - y0) > (t2 - t0) * (y1 - y0)


def _near_a_line(time_s: NDArray[np.float64], above_ns: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of n points lie near a line of median slope and median level (n,)."""
    i, j = np.triu_indices(len(time_s), 1)
    apart = time_s[j] - time_s[i]
    rising = apart > 0.0
    slope = float(np.median((above_ns[j] - above_ns[i])[rising] / apart[rising]))
    left = above_ns - slope * time_s
    left = left - np.median(left)
    usual = DEVIATION * float(np.median(np.abs(left)))
    return np.asarray(np.abs(left) <= FAR * usual + 1.0)


def _alike(left: NDArray[np.float64]) -> float:
    """How much less sure n residuals make than independent ones, by their lag-one correlation."""
    power = float(left @ left)
    if power <= 0.0:
        return 1.0
    correlation = min(max(float(left[1:] @ left[:-1]) / power, 0.0), MOST_ALIKE)
    return math.sqrt((1.0 + correlation) / (1.0 - correlation))


def _student(freedoms: int) -> float:
    """How much wider than normal the 95 % interval of Student's t is (Cornish-Fisher, two terms)."""
    z = CONFIDENCE
    first = (z**2 + 1.0) / 4.0
    second = (5.0 * z**4 + 16.0 * z**2 + 3.0) / 96.0
    return 1.0 + first / freedoms + second / freedoms**2
