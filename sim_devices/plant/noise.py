"""The noise of readings: white and normal by default, or as ugly as laboratories know it.

In units of the rig's ``noise_counts``, a sample of a channel is off by

    e_k = rho e_k-1 + sqrt(1 - rho^2) w_k,   rho = exp(-1 / correlation_samples),

with w normal, or Student's t with three degrees of freedom, of unit variance. Each visit of a pose
adds what stays the same while the mechanism stands there: normal, `visits` times as large as the
noise of the mean of a dwell of independent samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recordings.rig import Plan
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.quaternion import Array
from sim_devices.plant.seeds import VISITS, stream
from sim_devices.plant.stop import Stop


@dataclass(frozen=True, slots=True)
class Noise:
    """What the readings of a session are off by.

    Attributes:
        correlation_samples: samples after which a deviation has decayed to 1/e; 0 for white noise.
        heavy_tails: whether samples deviate as Student's t with three degrees of freedom.
        visits: standard deviation of what every visit adds, over that of a dwell's mean.

    Raises:
        CannotSimulate: a number below 0.
    """

    correlation_samples: float = 0.0
    heavy_tails: bool = False
    visits: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.correlation_samples < np.inf and 0 <= self.visits < np.inf):
            raise CannotSimulate(
                f"noise with correlation_samples = {self.correlation_samples} and visits = {self.visits} "
                "was asked for, expected finite numbers, 0 or above"
            )

    def samples(self, rng: np.random.Generator, count: int) -> Array:
        """(count,) deviations of unit variance, one after the other."""
        if self.heavy_tails:
            fresh = np.asarray(rng.standard_t(3, count) / np.sqrt(3.0))
        else:
            fresh = rng.standard_normal(count)
        if self.correlation_samples == 0.0 or count == 0:
            return fresh
        kept = np.exp(-1.0 / self.correlation_samples)
        driven = np.sqrt(1 - kept**2) * fresh
        driven[0] = fresh[0]
        out, now = [], 0.0
        for step in driven.tolist():
            now = kept * now + step
            out.append(now)
        return np.array(out)

    def of_visits(
        self, seed: int, channel: int, time_s: Array, stops: Sequence[Stop], plan: Plan
    ) -> Array:
        """(n,) what the visits add at times (n,) [standard deviations of a sample].

        It changes on the way, when the mechanism sets out for the next stop.
        """
        if self.visits == 0.0 or not stops:
            return np.zeros(len(time_s))
        of_mean = 1.0 / np.sqrt(max(1.0, plan.dwell * plan.sample))
        drawn = stream(seed, VISITS, channel).standard_normal(1 + len(stops))
        which = np.searchsorted([stop.start_s for stop in stops], time_s, side="right")
        return np.asarray(self.visits * of_mean * drawn[which])
