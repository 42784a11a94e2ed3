"""``thermal-growth``: the mechanism warms up, and all its lengths grow alike."""

from __future__ import annotations

from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, SerialMechanism
from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.mechanism.circumstances import Circumstances

_WHERE = "links"


class ThermalGrowth(Effect):
    """Lengths of the arm behind its base, or of a platform's points, are 1 + rate t times what they were."""

    name = "thermal-growth"
    needs = ("time_s",)

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        names = _lengths(site)
        self._targets = np.array([site.parameter(name) for name in names], dtype=np.intp)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return (_WHERE,) if _lengths(site) else ()

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.time_s is None:
            return "nobody knows when the poses were read"
        return None if np.ptp(at.time_s) else "all poses were read at one time"

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        cls.checked(site, described)
        return cls(site, described.where).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("rate", "rate", 1e-5),)

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        since = at.running_s
        if since is None:
            return None
        growing = np.tile(since[:, None], len(self._targets))
        amount = coefficients[0] * growing
        return Shift(self._targets, amount, growing[:, :, None], relative=True)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])


def _lengths(site: Site) -> tuple[str, ...]:
    """Names of all lengths that grow, those that are stated as 0 and held left out."""
    mechanism = site.rig.mechanism
    if isinstance(mechanism, SerialMechanism):
        places = mechanism.places
        behind = 0 if mechanism.base is None else places.index(mechanism.base) + 1
        owners = {*places[behind:], "tip"}
    else:
        owners = {point.name for point in (*mechanism.base_points, *mechanism.plate_points)}
    return tuple(
        p.name
        for p in site.table
        if p.dimension == "length"
        and (p.nominal or p.identify)
        and p.name.rpartition(".")[0] in owners
    )
