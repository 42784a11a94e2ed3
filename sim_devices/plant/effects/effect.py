"""What every effect is: a name, a place, a size, and the hooks by which it acts.

Nature offers each effect six moments to act, from the drawing of parameters to the counts.
An effect overrides those that it needs; the others change nothing. An effect serves one
run: calls come in order of time, so that it may remember (backlash does).

An effect is made in one of two ways: hidden, by `Effect.make`, in a form of nature's own and of
the size that was asked for; or described in the rig, by `Effect.described`, exactly as
`docs/formats.md` says under ``[[effect]]``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import Course
from sim_devices.plant.quaternion import Array
from sim_devices.truth import HiddenEffect

Geometry = TypeVar("Geometry")


@dataclass(frozen=True, slots=True)
class Rests:
    """The n stops of the plan, as the mechanism reaches them without hidden effects.

    Attributes:
        time_s: (n,) when, since the session began.
        value: by channel, (n,) joint variable, leg reading or coordinate [rad or m].
        coordinates: (k, J) joint variables, or (k, 7) turn and shift of a plate; k = n where
            there is a plan.
        end_s: when the session ends.
    """

    time_s: Array
    value: Mapping[str, Array]
    coordinates: Array
    end_s: float


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for when an effect is hidden.

    Attributes:
        where: a place that the effect offered.
        size: as written; the effect reads it.
        rig: as described.
        values: parameters drawn so far, SI, by name.
        rests: gives the stops of the plan.
        rng: for the shape.
    """

    where: str
    size: str
    rig: Rig
    values: Mapping[str, float]
    rests: Callable[[], Rests]
    rng: np.random.Generator


class Effect(ABC):
    """One thing at work that the rig description does not say."""

    name: ClassVar[str]
    steady: ClassVar[bool] = False
    """Set where `geometry` is overridden and does not depend on the time."""

    def __init__(self, where: str, size: float, unit: str) -> None:
        self.where = where
        self.size = size
        self.unit = unit

    @property
    def moves_geometry_in_time(self) -> bool:
        """Whether the geometry that it makes may be another at another time."""
        return type(self).geometry is not Effect.geometry and not self.steady

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

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        """The effect that the rig describes.

        Args:
            effect: as described.
            rig: that describes it.
            values: true parameters, SI, by name; its coefficients and settings among them.

        Raises:
            BadEffect: its values are not those of `docs/formats.md`, or it cannot sit there.
        """
        raise BadEffect(
            f"the rig describes '{effect.label}', but an effect '{cls.name}' can only be hidden; take it out"
        )

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

    def steps(self, channel: str, steps: Array, steps_of: Callable[[str], Array]) -> Array:
        """Counts less zero count (n,) before noise and rounding, out of those without the effect.

        Args:
            channel: that is read.
            steps: (n,) its counts less its zero count, not rounded.
            steps_of: gives the same of any channel, by name, as without effects.
        """
        return steps

    def counts(self, channel: str, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Counts that come out of the converter, out of those that should."""
        return counts


def moment_within(request: Request) -> float:
    """A moment in the middle half of the session [s]."""
    return request.rests().end_s * float(request.rng.uniform(0.25, 0.75))
