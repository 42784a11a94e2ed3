"""What an effect is to the solver: a name, a place, coefficients, and what they add to the model.

An effect can act at three places. It shifts what channels see, by an amount that may depend on
the true values; it moves parameters, by an amount that may differ from pose to pose; or it
changes codes, after quantisation. At zero coefficients it does nothing (codes aside).

Owns the seam: effects know no estimator, and estimators know no effect. Coefficients and
settings are those of `docs/formats.md`; users' own effects are classes like any other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Channel, DescribedEffect, Parameter, Quantity, Rig, parameters
from recordings.rig.quantity import SHOWN
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import imperfections

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One number of an effect that a solve can estimate.

    Attributes:
        name: as in the rig file, without its unit.
        dimension: as `recordings.rig` calls it: "angle", "length", "ratio", "compliance" ...
        plausible: size [SI] such as is met in practice: the prior standard deviation by which
            rivals are weighed, and by which a screen scales.
        low, high: physical bounds [SI].
        start: where a fit begins [SI]; the effect does nothing there, unless it changes codes.
    """

    name: str
    dimension: str
    plausible: float
    low: float = -np.inf
    high: float = np.inf
    start: float = 0.0


@dataclass(frozen=True, slots=True)
class Shift:
    """What an effect adds to T quantities at P poses.

    Attributes:
        targets: (T,) indices: of channels [rad or m] for `Effect.seen`, of parameters (with the
            imperfections behind them, SI) for `Effect.moved`.
        amount: (P, T).
        by_coefficients: (P, T, k).
        by_values: (P, T, C) derivative with all channels' true values, or None where there is none.
        relative: of parameters: whether the amount is a share of the parameter's present value.
    """

    targets: NDArray[np.intp]
    amount: Array
    by_coefficients: Array
    by_values: Array | None = None
    relative: bool = False

    def absolute(self, parameters: Array) -> Array:
        """(P, T, k) derivative by the coefficients [SI], where the targets are out of ``parameters``."""
        if not self.relative:
            return self.by_coefficients
        return self.by_coefficients * parameters[self.targets][:, None]


@dataclass(frozen=True, slots=True)
class Coded:
    """Expected codes of one channel behind its converter.

    Attributes:
        channel: its index.
        counts: (P,) expected mean code.
        slope: (P,) its derivative with the undisturbed mean.
        by_coefficients: (P, k).
    """

    channel: int
    counts: Array
    slope: Array
    by_coefficients: Array


class Site:
    """A rig as effects see it: where its channels and parameters stand in the solver's arrays.

    Attributes:
        rig: without regard to the effects that it describes already.
        table: its N parameters, those of effects left out.
        names: of the table's parameters and the imperfections behind them.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig.model_copy(update={"effects": ()})
        self.table: tuple[Parameter, ...] = parameters(self.rig)
        self.names = (*(p.name for p in self.table), *imperfections(self.rig))
        self._parameter = {name: i for i, name in enumerate(self.names)}
        self._channel = {c.name: i for i, c in enumerate(rig.channels)}

    def parameter(self, name: str) -> int:
        """Index of a parameter or imperfection; raises KeyError."""
        return self._parameter[name]

    def channel(self, name: str) -> int:
        """Index of a channel; raises KeyError."""
        return self._channel[name]

    def described(self, name: str) -> Channel:
        """The channel called ``name``; raises KeyError."""
        return self.rig.channels[self._channel[name]]

    def nominal(self, name: str) -> float:
        """Nominal value of a parameter, SI."""
        return self.table[self._parameter[name]].nominal

    def dimension(self, channel: str) -> str:
        """What a channel measures: "angle" or "length"."""
        return self.rig.dimension_of(self.described(channel).senses)

    @cached_property
    def spans(self) -> Mapping[str, tuple[float, float]]:
        """By channel with a range of counts, the values [rad or m] at its ends, lower first."""
        out = {}
        for c in self.rig.channels:
            if c.count_range is not None:
                gain, offset = self.nominal(f"{c.name}.gain"), self.nominal(f"{c.name}.offset")
                ends = sorted(gain * (end - c.zero_count) + offset for end in c.count_range)
                out[c.name] = (ends[0], ends[1])
        return out


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a recording offers an effect that looks for its own form (moments, ranges, harmonics).

    Attributes:
        values: (P, C) true values by the present model [rad or m].
        at: the circumstances.
        counts: (P, C) averaged readings [counts]; None where there are none.
    """

    values: Array
    at: Circumstances
    counts: Array | None = None


class Effect(ABC):
    """One effect at one place.

    Attributes:
        name: of the effect, as in the catalogue.
        scanned: whether the effect comes in `variants` that differ in a setting found by search
            (a moment, a harmonic), which a screen has to pay for.
        local: whether its shape is known only over the values at which it was seen: a series, not a law.
        needs: fields of `Circumstances` without which it does nothing ("torque" and "force" are
            computed, and readings in motion added, only for effects that need them).
    """

    name: ClassVar[str]
    scanned: ClassVar[bool] = False
    local: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ()

    def __init__(self, site: Site, where: str) -> None:
        self.site = site
        self.where = where

    @property
    def label(self) -> str:
        """``name@where``."""
        return f"{self.name}@{self.where}"

    # Where it can be, and in which forms.

    @classmethod
    @abstractmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        """Where in the rig it can sit."""

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        """Why these circumstances cannot show it at ``where``, in words for the user; or None."""
        return None

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        """The forms to try; one, unless it is `scanned`."""
        return (cls(site, where),)

    def closer(self, recorded: Recorded) -> tuple[Self, ...]:
        """Forms much like this one, where `variants` tries but some of many; none by default."""
        return ()

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        """The effect of a rig file; raises MechanismError for a place or values that it does not have.

        An effect whose form depends on settings overrides this, and reads them.
        """
        cls.checked(site, described)
        return cls(site, described.where).fitting(described)

    # What it is made of.

    @property
    @abstractmethod
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The k numbers that a solve estimates."""

    @property
    def settings(self) -> Mapping[str, Quantity]:
        """Fixed numbers of its form."""
        return {}

    # What it does.

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        """What channels see beyond their true ``values`` (P, C); ``coefficients`` are (k,)."""
        return None

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        """How far parameters stand from the rig's at each pose."""
        return None

    def coded(self, counts: Array, coefficients: Array, at: Circumstances) -> Coded | None:
        """What the converter makes of the expected ``counts`` (P, C)."""
        return None

    # How it is told.

    @abstractmethod
    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        """Its size [SI] over the recording: the coefficient, or of a shape its RMS."""

    @property
    def dimension(self) -> str:
        """Of its size."""
        return self.coefficients[0].dimension

    @property
    def unit(self) -> str:
        """Unit in which its size is told."""
        return SHOWN[self.dimension][0]

    @property
    def to_si(self) -> float:
        """Factor from that unit to SI."""
        return SHOWN[self.dimension][1]

    def entry(
        self, coefficients: Sequence[float], standard_errors: Sequence[float] | None = None
    ) -> DescribedEffect:
        """The ``[[effect]]`` that describes it at ``coefficients`` (k,) [SI], to be identified."""
        values: dict[str, Quantity] = dict(self.settings)
        for i, c in enumerate(self.coefficients):
            error = None if standard_errors is None else float(standard_errors[i])
            values[c.name] = Quantity(float(coefficients[i]), c.dimension, error, identify=True)
        return DescribedEffect(self.name, self.where, values)

    @classmethod
    def checked(cls, site: Site, described: DescribedEffect) -> None:
        """Raises MechanismError unless the rig has the place."""
        places = cls.places(site)
        if described.where not in places:
            raise MechanismError(
                f"the effect '{described.name}' of rig '{site.rig.name}' sits at '{described.where}', expected "
                f"one of: {', '.join(places) or '(this rig has no place for it)'}"
            )

    def fitting(self, described: DescribedEffect) -> Self:
        """Itself, when ``described`` gives exactly its coefficients and settings; else MechanismError."""
        expected = {c.name: c.dimension for c in self.coefficients}
        expected |= {name: quantity.dimension for name, quantity in self.settings.items()}
        wrong = [
            f"'{name}' ({quantity.dimension})"
            for name, quantity in described.values.items()
            if expected.get(name) != quantity.dimension
        ]
        missing = [
            f"'{name}' ({expected[name]})" for name in expected if name not in described.values
        ]
        if wrong or missing:
            parts = [f"has {', '.join(wrong)}"] * bool(wrong)
            parts += [f"lacks {', '.join(missing)}"] * bool(missing)
            raise MechanismError(
                f"the effect '{described.label}' of rig '{self.site.rig.name}' {' and '.join(parts)}; expected "
                f"{', '.join(f'{name} ({dimension})' for name, dimension in expected.items())}"
            )
        moving = [n for n in self.settings if described.values[n].identify]
        if moving:
            raise MechanismError(
                f"'{moving[0]}' of the effect '{described.label}' is a setting, which no solve can identify"
            )
        return self
