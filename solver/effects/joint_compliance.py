"""``joint-compliance``: a joint or leg gives way under the load it carries, behind its sensor.

The sensor sits on the motor's side of a spring: the link is behind what the sensor shows by
compliance times load. A leg under tension is longer than its sensor shows.
"""

from __future__ import annotations

import numpy as np

from recordings.rig import PlatformMechanism
from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.statics import why_unloaded


class JointCompliance(Effect):
    """delta = compliance times the torque that the drive exerts on the link; of a leg, minus its tension."""

    name = "joint-compliance"
    needs = ("torque",)

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        mechanism = site.rig.mechanism
        self._place = mechanism.places.index(where)
        sensor = site.rig.sensed_by(where)
        self._channel = np.array([] if sensor is None else [site.channel(sensor.name)], np.intp)
        self._sign = -1.0 if isinstance(mechanism, PlatformMechanism) else 1.0
        self._turns = mechanism.dimension_of(where) == "angle"

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        """Sensed joints or legs: of what nobody senses, nobody can say where it should be."""
        places = site.rig.mechanism.places
        return tuple(place for place in places if site.rig.sensed_by(place) is not None)

    @classmethod
    def untestable(cls, site: Site, where: str, at: Circumstances) -> str | None:
        if at.torque is None:
            return unloaded(site)
        if not at.torque[:, site.rig.mechanism.places.index(where)].any():
            if site.rig.mechanism.standing == "gravity-compensated":
                return "none of the arm's weight rests on it"
            return "no drive held it, so that it carried no load: hold it at some poses"
        return None

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        if self._turns:
            return (Coefficient("compliance", "angular compliance", 2e-4, low=0.0),)
        return (Coefficient("compliance", "compliance", 1e-5, low=0.0),)

    def seen(self, values: Array, coefficients: Array, at: Circumstances) -> Shift | None:
        if at.torque is None:
            return None
        load = self._sign * at.torque[:, [self._place]]
        return Shift(self._channel, load * coefficients[0], load[:, :, None])

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])


def unloaded(site: Site) -> str:
    """Why nobody knows the loads, in words."""
    return why_unloaded(site.rig) or (
        "the loads are not known: nobody recorded which joints were held, or more or fewer were held than "
        "the mechanism has freedoms"
    )
