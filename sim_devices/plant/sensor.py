"""A sensor as it really is: from what a joint or leg does to the counts that a device gives.

    counts = round(zero_count + (seen - offset) / gain + noise N(0, 1))

with true gain and offset, wrapped where the counter wraps, else clipped to its range. What
is seen is what is there, changed by the effects that sit at the channel; others act on what
reaches the converter, or on its codes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Channel
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array

_INVERSION_STEPS = 20
"""Enough for effects whose slope stays below one half."""


class Sensor:
    """One channel of the rig.

    Args:
        channel: its description.
        values: true parameters, SI, by name.
        effects: all effects at work; those that sit elsewhere change nothing here.
    """

    def __init__(
        self, channel: Channel, values: Mapping[str, float], effects: Sequence[Effect] = ()
    ) -> None:
        self.channel = channel
        self._values = values
        self._gain = values[f"{channel.name}.gain"]
        self._offset = values[f"{channel.name}.offset"]
        self._effects = effects

    def counts(
        self, course: Course, rng: np.random.Generator, noise: Array | None = None
    ) -> NDArray[np.int64]:
        """(n,) counts along ``course``.

        Args:
            course: of all channels.
            rng: of the noise, where none is given.
            noise: (n,) in standard deviations of one sample.
        """
        name = self.channel.name
        seen = course.value[name]
        for effect in self._effects:
            seen = effect.seen(name, seen, course)
        steps = (seen - self._offset) / self._gain
        for effect in self._effects:
            steps = effect.steps(name, steps, self._steps_along(course))
        if noise is None:
            noise = rng.standard_normal(len(steps))
        noisy = np.rint(self.channel.zero_count + steps + self.channel.noise * noise)
        counts = self._fitted(noisy.astype(np.int64))
        for effect in self._effects:
            counts = self._fitted(effect.counts(name, counts))
        return counts

    def _steps_along(self, course: Course) -> Callable[[str], Array]:
        values = self._values

        def steps_of(name: str) -> Array:
            return (course.value[name] - values[f"{name}.offset"]) / values[f"{name}.gain"]

        return steps_of

    def _fitted(self, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        """What the counter can show: wrapped, else clipped."""
        span, modulus = self.channel.count_range, self.channel.modulus_counts
        if modulus is not None:
            lowest = span[0] if span is not None else 0
            return lowest + (counts - lowest) % modulus
        return counts if span is None else np.clip(counts, *span)

    def value_at(self, raw: int) -> float:
        """Where a joint rests whose sensor reads ``raw`` [rad or m], noise aside."""
        steps = raw - self.channel.zero_count
        if (modulus := self.channel.modulus_counts) is not None:
            steps = (steps + modulus // 2) % modulus - modulus // 2
        wanted = self._gain * steps + self._offset
        value = np.array([wanted])
        for _ in range(_INVERSION_STEPS):
            seen = value
            for effect in self._effects:
                seen = effect.at_rest(self.channel.name, seen)
            if abs(float(seen[0]) - wanted) < 1e-12:
                break
            value = value + (wanted - seen)
        return float(value[0])

    @property
    def span(self) -> tuple[float, float] | None:
        """Least and greatest value [rad or m] that its counts can show, or None without limits."""
        ends = self.channel.count_range
        if ends is None:
            return None
        shown = [self._gain * (end - self.channel.zero_count) + self._offset for end in ends]
        return min(shown), max(shown)
