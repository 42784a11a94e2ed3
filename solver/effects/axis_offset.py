"""``axis-offset``: axes, or leg ends, that are stated to meet pass each other at a distance."""

from __future__ import annotations

import numpy as np

from recordings.rig import PlatformMechanism, SerialMechanism
from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.mechanism.circumstances import Circumstances

_ALONG = 0.05  # sine of the twist below which neighbouring axes run along each other and never meet


class AxisOffset(Effect):
    """Of a joint, a = offset in place of 0; of a point, the second of its two legs ends beside it."""

    name = "axis-offset"

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        legs = _shared(site)
        if where in legs:
            self._parts = tuple("xyz")
            moved = [f"{legs[where]}.{axis}" for axis in "xyz"]
        else:
            self._parts = ("offset",)
            moved = [f"{where}.a"]
        self._targets = np.array([site.parameter(name) for name in moved], dtype=np.intp)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return (*meeting_axes(site), *_shared(site))

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(Coefficient(part, "length", 1e-3) for part in self._parts)

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        each = np.broadcast_to(np.eye(len(coefficients)), (poses, *[len(coefficients)] * 2))
        return Shift(self._targets, np.tile(coefficients, (poses, 1)), each)

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        """Offset of the axes, or distance of the leg end from its point [m]."""
        if len(coefficients) == 1:
            return float(coefficients[0])
        return float(np.linalg.norm(coefficients))


def meeting_axes(site: Site) -> tuple[str, ...]:
    """Joints whose axis is stated to meet the next one's: Denavit-Hartenberg with ``a`` held at 0."""
    mechanism = site.rig.mechanism
    if not isinstance(mechanism, SerialMechanism):
        return ()
    return tuple(
        joint.name
        for joint in mechanism.joints
        if joint.convention == "dh"
        and joint.a.nominal == 0.0
        and not joint.a.identify
        and joint.a.tie is None
        and abs(np.sin(joint.alpha.nominal)) > _ALONG
    )


def _shared(site: Site) -> dict[str, str]:
    """By point where exactly two legs meet, the end of the second that may lie beside it."""
    mechanism = site.rig.mechanism
    if not isinstance(mechanism, PlatformMechanism):
        return {}
    out: dict[str, str] = {}
    for end in ("base", "plate"):
        ends: dict[str, list[str]] = {}
        for leg in mechanism.legs:
            ends.setdefault(leg.base if end == "base" else leg.plate, []).append(leg.name)
        out |= {point: f"{legs[1]}.{end}" for point, legs in ends.items() if len(legs) == 2}
    return out
