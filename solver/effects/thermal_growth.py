"""``thermal-growth``: the mechanism warms up, and all its lengths grow alike."""

from __future__ import annotations

import numpy as np

from recordings.rig import SerialMechanism
from solver.effects.effect import Array, Coefficient, Shift, Site
from solver.effects.warm_up import WarmUp
from solver.mechanism.circumstances import Circumstances

_WHERE = "links"


class ThermalGrowth(WarmUp):
    """Lengths of the arm behind its base, or of a platform's points, are 1 + rate c(t) times what they were.

    c is that of `warm_up`.
    """

    name = "thermal-growth"

    def __init__(
        self, site: Site, where: str, decay: float | None = None, lasted_s: float = 0.0
    ) -> None:
        super().__init__(site, where, decay, lasted_s)
        names = _lengths(site)
        self._targets = np.array([site.parameter(name) for name in names], dtype=np.intp)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return (_WHERE,) if _lengths(site) else ()

    @property
    def rate(self) -> Coefficient:
        return Coefficient("rate", "rate", 1e-5)

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        moved = self.moved_by(coefficients, at)
        if moved is None:
            return None
        lengths = len(self._targets)
        amount = np.tile(moved[0][:, None], lengths)
        by = np.tile(moved[1][:, None, :], (1, lengths, 1))
        return Shift(self._targets, amount, by, relative=True)


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
