"""``joint-compliance``: a driven joint, or a leg, gives way behind its sensor under what it carries.

The sensor sits on the motor's side of a spring, so that the link is behind by what the spring
yields. Here the joint variable is the motor's: the drive holds it, the sensor sees it, and the
geometry of the chain is turned back by the yield. A leg is longer than its sensor shows by what
it is stretched.

Hidden, the spring hardens a little, as strain-wave gears do: it yields c T asinh(load / T), where T
is twice the greatest load at the plan's stops. Size: the slope of the best straight line of
yield over load at the plan's stops [deg/Nm, m/N]. Described, it yields compliance times load.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Self, cast

import numpy as np

from recordings.rig import DescribedEffect, PlatformMechanism, Rig, SerialMechanism
from sim_devices.plant.chain import ChainGeometry
from sim_devices.plant.effects.described import check_place, read_values, told
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.loads import Loads, loads_at_rest, loads_of
from sim_devices.plant.effects.rms import slope
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.plate import PlateGeometry
from sim_devices.plant.quaternion import Array

_ROUNDS = 3
"""The yield moves the links, and so the load; each round takes a hundredth or less of the error before."""
_MOST = 1.0

Spring = Callable[[Array], Array]
"""Yield (n,) [rad or m] under loads (n,) [Nm or N]."""


class JointCompliance(Effect):
    """A spring behind a sensor.

    Args:
        where: joint or leg.
        size: compliance [``unit``].
        unit: "deg/Nm" or "m/N".
        place: number of the joint or leg.
        revolute: whether a joint turns.
        spring: how it yields.
        loads: gives what it carries.
    """

    name = "joint-compliance"
    steady = True

    def __init__(
        self,
        where: str,
        size: float,
        unit: str,
        *,
        place: int,
        revolute: bool,
        spring: Spring,
        loads: Loads,
    ) -> None:
        super().__init__(where, size, unit)
        self._place, self._revolute = place, revolute
        self._spring, self._loads = spring, loads

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        if not Loads.known(rig):
            return ()
        if isinstance(rig.mechanism, PlatformMechanism):
            return rig.mechanism.places
        if rig.mechanism.standing == "gravity-compensated":
            return tuple(p for p in rig.mechanism.places if rig.sensed_by(p) is not None)
        return rig.plan.drives if rig.plan is not None else ()

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = rig.dimension_of(where) == "angle"
        size = rng.uniform(5e-3, 5e-2) if angular else rng.uniform(2e-6, 2e-5)
        return f"{size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        rig, where = request.rig, request.where
        dimension = _dimension(rig, where)
        _, unit = told(dimension, 1.0)
        size = number_size(cls.name, request.size, unit, _MOST)
        compliance = size / told(dimension, 1.0)[0]
        place = rig.mechanism.places.index(where)
        load = loads_at_rest(request).carried[:, place]
        hard = 2 * float(np.abs(load).max()) or 1.0

        def bare(load: Array) -> Array:
            return np.asarray(hard * np.arcsinh(load / hard))

        factor = compliance / (slope(load, bare(load)) or 1.0)
        return cls(
            where,
            size,
            unit,
            place=place,
            revolute=_turns(rig, where),
            spring=lambda load: factor * bare(load),
            loads=loads_of(rig, request.values),
        )

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        dimension = _dimension(rig, effect.where)
        compliance = read_values(effect, values, {"compliance": dimension})["compliance"]
        return cls(
            effect.where,
            *told(dimension, compliance),
            place=rig.mechanism.places.index(effect.where),
            revolute=_turns(rig, effect.where),
            spring=lambda load: compliance * load,
            loads=loads_of(rig, values),
        )

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        if isinstance(geometry, PlateGeometry):
            # Its base end moved along the leg, so that it is shorter by what it is stretched.
            loads = self._loads.of_plate(geometry, coordinates)
            given = self._spring(loads.tension[:, self._place])
            base = np.broadcast_to(geometry.base, loads.along.shape).copy()
            base[:, self._place] -= given[:, None] * loads.along[:, self._place]
            return replace(geometry, base=base)
        if not isinstance(geometry, ChainGeometry):
            return geometry
        yielding: ChainGeometry = geometry
        for _ in range(_ROUNDS):
            given = self._spring(self._loads.of_chain(yielding, coordinates).torque[:, self._place])
            yielding = self._yielded(geometry, given, coordinates.shape)
        return cast(Geometry, yielding)

    def _yielded(
        self, geometry: ChainGeometry, given: Array, shape: tuple[int, ...]
    ) -> ChainGeometry:
        yielded = np.zeros(shape)
        yielded[:, self._place] = given
        if self._revolute:
            return replace(geometry, theta_offset=geometry.theta_offset - yielded)
        return replace(geometry, s=geometry.s - yielded)


def _turns(rig: Rig, where: str) -> bool:
    return isinstance(rig.mechanism, SerialMechanism) and rig.dimension_of(where) == "angle"


def _dimension(rig: Rig, where: str) -> str:
    return "angular compliance" if rig.dimension_of(where) == "angle" else "compliance"
