"""``thermal-growth``: all lengths of the mechanism grow as the session goes on.

Of a chain: every length behind its base (not that of a slide's travel); of a platform: the
coordinates of all points, while the sensors keep their scale. Hidden, the growth is even or
saturates as the machine warms up (`warm_up.Creep`). Size: the slope of its best straight line
over the plan's stops, in parts of the length a second. Described, it is rate times time, or fades with a
``decay``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig, SerialMechanism
from sim_devices.plant.chain import ChainGeometry, Fixed
from sim_devices.plant.effects.described import check_place, read_values
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.effects.warm_up import Creep
from sim_devices.plant.plate import PlateGeometry
from sim_devices.plant.quaternion import Array

_LINKS = "links"


class ThermalGrowth(Effect):
    """A growing mechanism.

    Args:
        size: rate [1/s].
        creep: its course.
        first: number of the first joint whose lengths grow; of a chain.
    """

    name = "thermal-growth"

    def __init__(self, size: float, creep: Creep, first: int) -> None:
        super().__init__(_LINKS, size, "1/s")
        self._creep, self._first = creep, first

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return (_LINKS,)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(1e-6, 1e-5):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        rate = number_size(cls.name, request.size, "1/s", most=0.01, signed=True)
        return cls(rate, Creep.draw(request.rests(), request.rng), _first(request.rig))

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        told = read_values(effect, values, {"rate": "rate", "decay": "rate"})
        return cls(told["rate"], Creep.fading(told["decay"]), _first(rig))

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        grown = (self.size * self._creep.at(time_s))[:, None]
        if isinstance(geometry, PlateGeometry):
            factor = 1 + grown[:, :, None]
            return replace(geometry, base=geometry.base * factor, plate=geometry.plate * factor)
        if not isinstance(geometry, ChainGeometry):
            return geometry
        joints = np.arange(coordinates.shape[1])
        factor = 1 + grown * (joints >= self._first)
        out = replace(geometry, s=geometry.s * factor, a=geometry.a * factor)
        if geometry.links is not None:
            # What lies behind a joint is the origin of the next one, or the tip.
            next_grows = 1 + grown * (joints + 1 >= self._first)
            links = Fixed(geometry.links.turn, geometry.links.shift * next_grows[:, :, None])
            out = replace(out, links=links)
        if geometry.ahead is not None:
            own = 1 + grown * (np.arange(coordinates.shape[1] + 1) >= self._first)
            out = replace(
                out, ahead=replace(geometry.ahead, shift=geometry.ahead.shift * own[:, :, None])
            )
        if geometry.seat is not None and geometry.first_reach is not None and self._first == 0:
            out = replace(
                out,
                seat=replace(
                    geometry.seat, shift=geometry.seat.shift + grown * geometry.first_reach
                ),
            )
        return out


def _first(rig: Rig) -> int:
    mechanism = rig.mechanism
    if not isinstance(mechanism, SerialMechanism) or mechanism.base is None:
        return 0
    return mechanism.places.index(mechanism.base) + 1
