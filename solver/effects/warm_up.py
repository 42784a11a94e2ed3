"""How something creeps while a machine warms up: evenly, or ever more slowly until it is warm.

A body that is heated evenly and loses heat in proportion to how warm it is (Newton's law of
cooling) nears its last temperature as 1 - exp(-t / tau), and so does what grows with it. Told by
how fast it begins,

    c(t) = integral of exp(-decay s) ds, s = 0 ... t = (1 - exp(-decay t)) / decay,   decay = 1 / tau,

which is t itself where nothing slows it: a straight line is the case of decay 0, and nothing special
happens to a fit that ends near it. When the clock is started does not matter: of a machine that was
half warm by then, the same decay is left.

Owns the course, its coefficients, and which decays are tried. What it is that creeps so, is in the effects'
own files.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect
from solver.effects.effect import Array, Coefficient, Effect, Recorded, Site
from solver.mechanism.circumstances import Circumstances

_DECAYS = (1.0, 2.0, 4.0, 8.0, 16.0)  # per session: neighbours are nine tenths alike
_FINER = 9  # decays between the two neighbours of one of those
_USUAL = 1e-3  # 1/s: a quarter of an hour
_SMALL = 1e-2  # of decay times t: below it series are exact to rounding
_GROWS = -30.0  # of the same: nothing warms up so, but a fit may pass by


class WarmUp(Effect):
    """What moves as rate c(t), t since the session began: on a straight line, or with a ``decay``.

    Args:
        site: the rig.
        where: what moves.
        decay: where the decay begins to be sought [1/s]; None for a straight line.
        lasted_s: how long the sessions lasted in which it is sought; 0 where that is not known.
    """

    needs = ("time_s",)
    scanned = True

    def __init__(
        self, site: Site, where: str, decay: float | None = None, lasted_s: float = 0.0
    ) -> None:
        super().__init__(site, where)
        self._decay = decay
        self._lasted_s = lasted_s

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.time_s is None:
            return "nobody knows when the poses were read"
        return None if np.ptp(at.time_s) else "all poses were read at one time"

    @classmethod
    def variants(cls, site: Site, where: str, recorded: Recorded) -> tuple[Self, ...]:
        since = recorded.at.running_s
        lasted = 0.0 if since is None else float(since.max(initial=0.0))
        if not lasted > 0.0:
            return (cls(site, where),)
        warming = (cls(site, where, decay / lasted, lasted) for decay in _DECAYS)
        return (cls(site, where), *warming)

    def closer(self, recorded: Recorded) -> tuple[Self, ...]:
        if self._decay is None:
            return ()
        step = _DECAYS[1] / _DECAYS[0]
        near = self._decay * np.geomspace(1.0 / step, step, _FINER)
        return tuple(
            type(self)(self.site, self.where, decay, self._lasted_s) for decay in near.tolist()
        )

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        decay = described.values.get("decay")
        effect = cls(site, described.where, None if decay is None else decay.nominal)
        return effect.fitting(described)

    @property
    @abstractmethod
    def rate(self) -> Coefficient:
        """How fast it moves, in the mean."""

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        if self._decay is None:
            return (self.rate,)
        # What comes to rest early begins as many times faster than in the mean.
        x = max(self._decay * self._lasted_s, 0.0)
        faster = x / -np.expm1(-x) if x > 0.0 else 1.0
        rate = replace(self.rate, plausible=float(faster * self.rate.plausible))
        start = self._decay
        return (rate, Coefficient("decay", "rate", abs(start) or _USUAL, 0.0, start=start))

    def moved_by(self, coefficients: Array, at: Circumstances) -> tuple[Array, Array] | None:
        """How far it has moved at P poses, (P,), and by each of k coefficients, (P, k)."""
        since = at.running_s
        if since is None:
            return None
        rate, *decay = coefficients
        crept, by_decay = course(since, *decay or (0.0,))
        by = np.stack([crept, rate * by_decay], axis=1)[:, : len(coefficients)]
        return rate * crept, by

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        """Slope of the best straight line over the recording."""
        moved, time_s = self.moved_by(coefficients, at), at.running_s
        if moved is None or time_s is None:
            return float(coefficients[0])
        away = time_s - time_s.mean()
        return float(away @ moved[0]) / float(away @ away)


def course(time_s: Array, decay: float) -> tuple[Array, Array]:
    """c (P,) [s] and its derivative with the decay [s^2], at times (P,) since the session began."""
    x = np.maximum(decay * time_s, _GROWS)
    small = np.abs(x) < _SMALL
    safe = np.where(small, 1.0, x)
    share = np.where(
        small,
        1.0 - x / 2.0 + x**2 / 6.0 - x**3 / 24.0 + x**4 / 120.0 - x**5 / 720.0,
        -np.expm1(-safe) / safe,
    )
    slope = np.where(
        small,
        -0.5 + x / 3.0 - x**2 / 8.0 + x**3 / 30.0 - x**4 / 144.0 + x**5 / 840.0,
        (np.exp(-safe) * (1.0 + safe) - 1.0) / safe**2,
    )
    return time_s * share, time_s**2 * slope
