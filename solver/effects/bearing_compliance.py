"""``bearing-compliance``: a joint gives way across its axis, under the weight that leans on it.

Its bearing, or the link that carries it, is equally soft about both axes across the joint's own:
what is behind the joint tilts as the moment on it would have it. No sensor sees that.
"""

from __future__ import annotations

import numpy as np

from recordings.rig import SerialMechanism
from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.effects.joint_compliance import unloaded
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import TILTS


class BearingCompliance(Effect):
    """tilt = - compliance times the moment that holds the link across the joint's axis."""

    name = "bearing-compliance"
    needs = ("moment",)

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        self._place = site.rig.mechanism.places.index(where)
        self._tilts = np.array([site.parameter(f"{where}.{tilt}") for tilt in TILTS], np.intp)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        """Sensed joints that turn."""
        mechanism = site.rig.mechanism
        if not isinstance(mechanism, SerialMechanism):
            return ()
        return tuple(
            joint.name
            for joint in mechanism.joints
            if joint.type == "revolute" and site.rig.sensed_by(joint.name) is not None
        )

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.moment is None:
            return unloaded(site)
        if not at.moment[:, site.rig.mechanism.places.index(where)].any():
            return "no weight leans on it"
        return None

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return (Coefficient("compliance", "angular compliance", 5e-5, low=0.0),)

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        if at.moment is None:
            return None
        way = -at.moment[:, self._place]
        return Shift(self._tilts, coefficients[0] * way, way[:, :, None])

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])
