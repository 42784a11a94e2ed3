"""What every hidden effect is: a name, a place, a size, and the hooks by which it acts.

Nature offers each effect five moments to act, from the drawing of parameters to the counts.
An effect overrides those that it needs; the others change nothing. An effect serves one
run: calls come in order of time, so that it may remember (backlash does).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array
from sim_devices.truth import HiddenEffect

Geometry = TypeVar("Geometry")


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for when an effect is hidden.

    Attributes:
        where: a place that the effect offered.
        size: as written; the effect reads it.
        rig: as described.
        values: parameters drawn so far, SI, by name.
        travel: gives, for each channel, its values [rad or m] at the stops of the plan.
        rng: for the shape.
    """

    where: str
    size: str
    rig: Rig
    values: Mapping[str, float]
    travel: Callable[[], Mapping[str, Array]]
    rng: np.random.Generator


class Effect(ABC):
    """One thing at work that the rig description does not say."""

    name: ClassVar[str]

    def __init__(self, where: str, size: float, unit: str) -> None:
        self.where = where
        self.size = size
        self.unit = unit

    @property
    def told(self) -> HiddenEffect:
        """How the truth file tells it."""
        return HiddenEffect(self.name, self.where, self.size, self.unit)

    @classmethod
    @abstractmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        """Where in ``rig`` it can sit."""

    @classmethod
    @abstractmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        """A size such as is met in practice, as a user would write it."""

    @classmethod
    @abstractmethod
    def make(cls, request: Request) -> Self:
        """The effect as asked for; raises BadEffect for a size that it cannot have."""

    def values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """True parameters with the effect, out of those without it."""
        return values

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        """Geometry at n moments [s] and coordinates (n, U), out of that of the bare mechanism."""
        return geometry

    def at_rest(self, channel: str, value: Array) -> Array:
        """What the channel sees where the mechanism rests at ``value`` (n,), for a drive's servo."""
        return value

    def seen(self, channel: str, value: Array, course: Course) -> Array:
        """What the channel sees along a course, out of what it saw without the effect."""
        return self.at_rest(channel, value)

    def counts(self, channel: str, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Counts that come out of the converter, out of those that should."""
        return counts
