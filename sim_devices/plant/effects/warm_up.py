"""How something creeps during a session: evenly, or fast at first until the machine is warm.

    linear  c(t) = t          warming  c(t) ~ 1 - exp(-t / tau)

Hidden, each is so scaled that its best straight line over the plan's stops has the slope 1 [s per s];
described, so that it begins with that slope. A rate times c is what has crept by.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sim_devices.plant.effects.effect import Rests
from sim_devices.plant.effects.rms import slope
from sim_devices.plant.quaternion import Array


@dataclass(frozen=True, slots=True)
class Creep:
    """The course of a creep.

    Attributes:
        time_constant_s: of the warming, infinite where it is linear.
        factor: makes the slope 1 [s].
    """

    time_constant_s: float = np.inf
    factor: float = 1.0

    @classmethod
    def draw(cls, rests: Rests, rng: np.random.Generator) -> Self:
        """Linear or warming, as chance has it."""
        warming = rng.uniform() < 0.5
        constant = rests.end_s * rng.uniform(0.3, 1.0)
        if not warming:
            return cls()
        rise = slope(rests.time_s, -np.expm1(-rests.time_s / constant))
        return cls(constant, 1.0 / rise) if rise > 0.0 else cls()

    @classmethod
    def fading(cls, decay: float) -> Self:
        """That begins with the slope 1 and slows down with the time constant 1 / ``decay``; 0 is linear."""
        return cls(1.0 / decay, 1.0 / decay) if decay else cls()

    def at(self, time_s: Array) -> Array:
        """(n,) what a rate is multiplied with at times (n,) [s]."""
        if np.isinf(self.time_constant_s):
            return time_s
        return np.asarray(-self.factor * np.expm1(-time_s / self.time_constant_s))
