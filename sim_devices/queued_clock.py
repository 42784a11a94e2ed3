"""A device with a clock of its own behind a line with queues: what a host sees of its time. Pure.

For estimators of clocks: many seeded sessions in little time, with the truth beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_devices.crystal import LARGEST_ERROR, Crystal

EPOCH_NS = 1_700_000_000_000_000_000
"""Host time at which time 0 of a session is."""

TAIL_S = 150e-6
"""Mean delay beyond the shortest one [s]."""

_DELAYS: Mapping[str, Callable[[np.random.Generator, int], NDArray[np.float64]]] = {
    "exponential": lambda rng, n: rng.exponential(TAIL_S, n),
    "gamma": lambda rng, n: rng.gamma(2.0, 0.5 * TAIL_S, n),
    "half normal": lambda rng, n: np.abs(rng.normal(0.0, TAIL_S, n)),
}
"""Delays beyond the shortest one, by name."""


@dataclass(frozen=True)
class Arrivals:
    """One session, and its truth.

    Attributes:
        device_ns: (n,) device time of each sample [ns].
        host_ns: (n,) when it arrived [ns].
        offset_ns: host time minus device time of a sample that did not wait, beyond `EPOCH_NS`,
            at device time 0 [ns].
        drift: by how much that grows [s/s].
    """

    device_ns: NDArray[np.int64]
    host_ns: NDArray[np.int64]
    offset_ns: float
    drift: float

    def true_offset_ns(self, device_ns: int) -> float:
        """Host time minus device time at ``device_ns``, beyond `EPOCH_NS` [ns]."""
        return self.offset_ns + self.drift * device_ns


@dataclass(frozen=True)
class QueuedClock:
    """A device that samples on request, and the line behind which it is.

    Attributes:
        seconds: length of a session.
        rate_hz: samples a second.
        step_ns: step in which its clock counts.
        law: of its delays: exponential, gamma, half normal.
        shortest_s: shortest delay.
        punctual_s: standard deviation of the host's requests from their schedule.
        bursts: whether the line is busy now and then: every 8 s or so, up to 1.2 s, 1 to 20 ms.
        crystal: what its clock counts by; None draws one for each session.
    """

    seconds: float = 30.0
    rate_hz: float = 100.0
    step_ns: int = 1_000
    law: str = "exponential"
    shortest_s: float = 0.8e-3
    punctual_s: float = 50e-6
    bursts: bool = True
    crystal: Crystal | None = None

    def play(self, seed: int) -> Arrivals:
        """A session; the same seed gives the same."""
        rng = np.random.default_rng([seed, 11])
        crystal = self.crystal or Crystal(rng.uniform(-LARGEST_ERROR, LARGEST_ERROR))
        offset_s = rng.uniform(-100.0, 100.0)
        count = round(self.seconds * self.rate_hz)
        time_s = np.arange(count) / self.rate_hz + rng.uniform()
        time_s = np.sort(time_s + self.punctual_s * rng.standard_normal(count))
        device_s = crystal.elapsed(1.0) * (time_s - offset_s)
        device_ns = np.floor(device_s * 1e9 / self.step_ns).astype(np.int64) * self.step_ns
        delay_s = self.shortest_s + _DELAYS[self.law](rng, count)
        for _ in range(rng.poisson(self.seconds / 8.0) if self.bursts else 0):
            begin, lasts = rng.uniform(0.0, self.seconds), rng.uniform(0.05, 1.2)
            busy = (time_s - time_s[0] > begin) & (time_s - time_s[0] < begin + lasts)
            delay_s[busy] += rng.uniform(1e-3, 20e-3)
        # A line does not overtake.
        arrival_s = np.maximum.accumulate(time_s + delay_s)
        return Arrivals(
            device_ns=device_ns,
            host_ns=EPOCH_NS + np.rint(arrival_s * 1e9).astype(np.int64),
            offset_ns=1e9 * (offset_s + self.shortest_s),
            drift=1.0 / crystal.elapsed(1.0) - 1.0,
        )
