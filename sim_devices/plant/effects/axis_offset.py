"""``axis-offset``: axes, or leg ends, that should meet do not.

Of a chain: the axes before and behind a link whose ``a`` is stated as 0 pass each other at a
distance. Of a platform: at a point where exactly two legs meet, the second of them ends beside
the point. Size: the distance [m]; to which side a leg ends is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, PlatformMechanism, Rig, SerialMechanism
from sim_devices.plant.effects.described import check_place, read_values
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.plate import PlateGeometry
from sim_devices.plant.quaternion import Array

_CROSSING = 0.05
"""Axes whose twist has a smaller sine than this run along each other; they do not meet."""


class AxisOffset(Effect):
    """Axes, or leg ends, apart.

    Args:
        where: joint or point.
        size: how far [m].
        leg: number of the leg that ends beside the point, or None for a joint.
        in_base: whether the point is one of the base.
        beside: (3,) [m] in the point's frame.
    """

    name = "axis-offset"
    steady = True

    def __init__(
        self,
        where: str,
        size: float,
        leg: int | None = None,
        in_base: bool = False,
        beside: Array | None = None,
    ) -> None:
        super().__init__(where, size, "m")
        self._leg, self._in_base = leg, in_base
        self._beside = np.zeros(3) if beside is None else beside

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return (*meeting_axes(rig), *_meeting_legs(rig))

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.3e-3, 3e-3):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        joint = request.where in meeting_axes(request.rig)
        size = number_size(cls.name, request.size, "m", most=0.1, signed=joint)
        if joint:
            return cls(request.where, size)
        leg, in_base = _meeting_legs(request.rig)[request.where]
        way = request.rng.standard_normal(3)
        return cls(request.where, size, leg, in_base, size * way / np.linalg.norm(way))

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        if effect.where in meeting_axes(rig):
            return cls(effect.where, read_values(effect, values, {"offset": "length"})["offset"])
        true = read_values(effect, values, dict.fromkeys("xyz", "length"))
        beside = np.array([true[axis] for axis in "xyz"])
        leg, in_base = _meeting_legs(rig)[effect.where]
        return cls(effect.where, float(np.linalg.norm(beside)), leg, in_base, beside)

    def values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        if self._leg is not None:
            return values
        name = f"{self.where}.a"
        return {**values, name: values[name] + self.size}

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        if self._leg is None or not isinstance(geometry, PlateGeometry):
            return geometry
        moved = np.zeros_like(geometry.base)
        moved[..., self._leg, :] = self._beside
        if self._in_base:
            return replace(geometry, base=geometry.base + moved)
        return replace(geometry, plate=geometry.plate + moved)


def meeting_axes(rig: Rig) -> tuple[str, ...]:
    """Joints whose axis is stated to meet the next one's: Denavit-Hartenberg with ``a`` fixed at 0."""
    if not isinstance(rig.mechanism, SerialMechanism):
        return ()
    return tuple(
        joint.name
        for joint in rig.mechanism.joints
        if joint.convention == "dh"
        and joint.a.nominal == 0.0
        and not joint.a.identify
        and joint.a.tie is None
        and abs(np.sin(joint.alpha.nominal)) > _CROSSING
    )


def _meeting_legs(rig: Rig) -> dict[str, tuple[int, bool]]:
    """By point where exactly two legs meet: number of the second, and whether it is in the base."""
    mechanism = rig.mechanism
    if not isinstance(mechanism, PlatformMechanism):
        return {}
    out = {}
    for in_base, ends in (
        (True, [leg.base for leg in mechanism.legs]),
        (False, [leg.plate for leg in mechanism.legs]),
    ):
        for point in dict.fromkeys(ends):
            legs = [k for k, end in enumerate(ends) if end == point]
            if len(legs) == 2:
                out[point] = (legs[1], in_base)
    return out
