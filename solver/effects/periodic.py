"""``eccentricity`` and ``cyclic-error``: errors that repeat with every turn of a sensor, or n times in it.

A disc whose centre lies e beside the axis, read at radius r, errs by (e / r) cos(phi - phi_0)
(Fiedler's "once per revolution"): sine and cosine are one effect. Gear teeth, resolver poles and
interpolation in an encoder repeat a whole number of times in a turn. Which number, is not known
beforehand: every harmonic that the poses can tell from the lower ones is a form of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numpy.typing import NDArray

from recordings.rig import DescribedEffect, Quantity
from solver.effects.channel import ChannelEffect, rms_about_mean
from solver.effects.effect import Array, Coefficient, Recorded, Shift, Site
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances

_HARMONICS = range(2, 41)
_ALIKE = 0.98  # cosine of the larger angle between two harmonics that poses do not tell apart
_SHOWS = 1e-3  # of a wave that a straight line through it leaves, to be worth a look


class Periodic(ChannelEffect):
    """delta = cos cos(n phi) + sin sin(n phi), phi the sensor's angle: v, or 2 pi v / turn of a length."""

    def __init__(self, site: Site, where: str, harmonic: float) -> None:
        super().__init__(site, where)
        self.harmonic = harmonic
        self._frequency = harmonic * _turning(site, where)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return tuple(
            name
            for name in super().places(site)
            if site.dimension(name) == "angle" or site.described(name).turn is not None
        )

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        phase = self._frequency * values[:, self.channel]
        cos, sin = np.cos(phase), np.sin(phase)
        slope = self._frequency * (coefficients[1] * cos - coefficients[0] * sin)
        return self.shift(np.stack([cos, sin], axis=1), coefficients, slope, values.shape[1])

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        shift = self.seen(values, coefficients, at)
        assert shift is not None
        return rms_about_mean(shift)


class Eccentricity(Periodic):
    """Once per revolution: a disc off its centre, a shaft off its bearing."""

    name = "eccentricity"

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where, 1.0)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        plausible = self.of_size(3e-3, 2e-4)
        return tuple(Coefficient(part, self.measures, plausible) for part in ("cos", "sin"))


class CyclicError(Periodic):
    """n periods per revolution: teeth, poles, interpolation."""

    name = "cyclic-error"
    scanned = True

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        phi = _turning(site, where) * recorded.values[:, site.channel(where)]
        return tuple(cls(site, where, float(n)) for n in _told_apart(phi))

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        harmonic = described.values.get("harmonic", Quantity(1.0)).nominal
        if harmonic <= 0:
            raise MechanismError(
                f"'harmonic' of the effect '{described.label}' is {harmonic:g}, expected above 0"
            )
        return cls(site, described.where, harmonic).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        plausible = self.of_size(1e-3, 1e-4)
        return tuple(Coefficient(part, self.measures, plausible) for part in ("cos", "sin"))

    @property
    def settings(self) -> Mapping[str, Quantity]:
        return {"harmonic": Quantity(self.harmonic, "ratio")}


def _turning(site: Site, where: str) -> float:
    """Angle of the sensor per value of the channel."""
    turn = site.described(where).turn
    if site.dimension(where) == "angle" or turn is None:
        return 1.0
    return 2.0 * np.pi / turn


def _told_apart(phi: Array) -> list[int]:
    """Harmonics of the angles ``phi`` (P,) that no lower one of them resembles at these poses.

    Beside an offset and a gain, that is: two harmonics whose planes of waves, freed of a
    straight line, lie within a small angle of each other (the larger principal angle) would
    fit the same readings.
    """
    if len(phi) < 5 or np.ptp(phi) == 0.0:
        return []
    line = np.linalg.qr(np.stack([np.ones(len(phi)), phi - phi.mean()], axis=1))[0]
    kept: list[int] = []
    planes: list[NDArray[np.float64]] = []
    for n in _HARMONICS:
        waves = np.stack([np.cos(n * phi), np.sin(n * phi)], axis=1)
        rest = waves - line @ (line.T @ waves)
        left, singular, _ = np.linalg.svd(rest, full_matrices=False)
        if singular[0] < _SHOWS * np.sqrt(len(phi)):
            continue
        alike = (np.linalg.svd(plane.T @ left, compute_uv=False)[-1] for plane in planes)
        if all(cosine < _ALIKE for cosine in alike):
            kept.append(n)
            planes.append(left)
    return kept
