"""``fixture-compliance`` and ``fixture-slip``: what holds the end of a chain, or the pivot of a plate, moves.

A fixture yields in the direction of the force on it, as a spring that is equally stiff along all
axes; or it was moved at one moment, by a knock or a screw that gave way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, PlatformMechanism, Quantity
from solver.effects.effect import Array, Coefficient, Effect, Recorded, Shift, Site
from solver.effects.joint_compliance import unloaded
from solver.effects.moments import between, looked_at, no_moment
from solver.mechanism.circumstances import Circumstances

_WHERE = "fixture"
_SHIFTS = ("x", "y", "z")
_TURNS = ("rx", "ry", "rz")


class FixtureEffect(Effect):
    """An effect that displaces the fixture."""

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        """The fixture, of a chain whose end is held or a plate that turns about a pivot."""
        mechanism = site.rig.mechanism
        if isinstance(mechanism, PlatformMechanism):
            return (_WHERE,) if mechanism.plate == "pivoted" else ()
        return () if mechanism.closure.constraint == "open" else (_WHERE,)

    def mount(self, parts: tuple[str, ...]) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """Indices of the fixture's displacements."""
        return np.array([self.site.parameter(f"mount.{part}") for part in parts], dtype=np.intp)


class FixtureCompliance(FixtureEffect):
    """The fixture is displaced by compliance times the force on it."""

    name = "fixture-compliance"
    needs = ("force",)

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.force is None:
            return unloaded(site)
        return None if at.force.any() else "nothing presses on the fixture"

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("compliance", "compliance", 1e-5, low=0.0),)

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        if at.force is None:
            return None
        return Shift(self.mount(_SHIFTS), coefficients[0] * at.force, at.force[:, :, None])

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])


class FixtureSlip(FixtureEffect):
    """The fixture is displaced, in its own frame, from one moment on; a pivot is shifted only."""

    name = "fixture-slip"
    needs = ("time_s",)
    scanned = True

    def __init__(self, site: Site, where: str, at_s: float) -> None:
        super().__init__(site, where)
        self._at_s = at_s
        platform = isinstance(site.rig.mechanism, PlatformMechanism)
        self._parts = _SHIFTS if platform else (*_SHIFTS, *_TURNS)

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        return no_moment(at)

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        return tuple(cls(site, where, moment) for moment in looked_at(recorded.at))

    def closer(self, recorded: Recorded) -> tuple[Self, ...]:
        return tuple(
            type(self)(self.site, self.where, moment) for moment in between(self._at_s, recorded.at)
        )

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        moment = described.values.get("at", Quantity()).nominal
        return cls(site, described.where, moment).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(
            Coefficient(part, "length", 1e-3)
            if part in _SHIFTS
            else Coefficient(part, "angle", 3e-3)
            for part in self._parts
        )

    @property
    def settings(self) -> Mapping[str, Quantity]:
        return {"at": Quantity(self._at_s, "time")}

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        if at.time_s is None:
            return None
        after = np.where(at.time_s >= self._at_s, 1.0, 0.0)
        each = after[:, None, None] * np.eye(len(coefficients))
        return Shift(self.mount(self._parts), after[:, None] * coefficients, each)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        """Length of the displacement [m]."""
        return float(np.linalg.norm(coefficients[:3]))
