"""``fixture-compliance``: what holds the end of a chain, or the pivot of a plate, gives way under load.

Hidden, the mount of a chain (`mount.Mount`) is a spring at a point some way from its origin, not
equally stiff along its three axes (within +-10 %), which also tilts a little: as stiff against a
moment as three such springs a metre away. A pivot yields along its axes only. Size: the
compliance that describes the yield at the plan's stops best, over all directions [m/N].
Described, the fixture is displaced by compliance times the force on it, and does not tilt.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Self, cast

import numpy as np

from recordings.rig import DescribedEffect, PlatformMechanism, Rig
from sim_devices.plant.chain import ChainGeometry, Fixed
from sim_devices.plant.effects.described import check_place, read_values
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.loads import Loads, loads_at_rest, loads_of
from sim_devices.plant.effects.mount import Mount
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.plate import PlateGeometry
from sim_devices.plant.quaternion import Array, about, cross

FIXTURE = "fixture"
_UNEQUAL = 0.1
_ASIDE_M = 0.02
_TILT_M = 1.0
_ROUNDS = 2


class FixtureCompliance(Effect):
    """A fixture on a spring.

    Args:
        size: compliance [m/N].
        along: (3,) compliance along each axis [m/N].
        point: (3,) of the spring in the fixture's frame [m].
        tilting: angular compliance [rad/Nm].
        loads: gives the force on it.
        mount: of a chain.
    """

    name = "fixture-compliance"
    steady = True

    def __init__(
        self,
        size: float,
        *,
        along: Array,
        point: Array,
        tilting: float,
        loads: Loads,
        mount: Mount | None,
    ) -> None:
        super().__init__(FIXTURE, size, "m/N")
        self._mount = mount
        self._along, self._point, self._tilting = along, point, tilting
        self._loads = loads

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return (FIXTURE,) if Loads.known(rig) and has_fixture(rig) else ()

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(2e-6, 2e-5):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        size = number_size(cls.name, request.size, "m/N", most=0.01)
        unequal = 1 + request.rng.uniform(-_UNEQUAL, _UNEQUAL, 3)
        point = request.rng.uniform(-_ASIDE_M, _ASIDE_M, 3)
        spread = loads_at_rest(request).force.var(axis=0)
        if spread.sum() > 0.0:
            unequal = unequal * spread.sum() / (unequal @ spread)
        return cls(
            size,
            along=size * unequal,
            point=point,
            tilting=size / _TILT_M**2,
            loads=loads_of(request.rig, request.values),
            mount=mount_of(request.rig, request.values),
        )

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        compliance = read_values(effect, values, {"compliance": "compliance"})["compliance"]
        return cls(
            compliance,
            along=np.full(3, compliance),
            point=np.zeros(3),
            tilting=0.0,
            loads=loads_of(rig, values),
            mount=mount_of(rig, values),
        )

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        if isinstance(geometry, PlateGeometry):
            base = geometry.base
            for _ in range(_ROUNDS):
                force = self._loads.of_plate(replace(geometry, base=base), coordinates).force
                base = geometry.base - (self._along * force)[:, None]
            return replace(geometry, base=base)
        if not isinstance(geometry, ChainGeometry) or self._mount is None:
            return geometry
        yielding: ChainGeometry = geometry
        for _ in range(_ROUNDS):
            loads = self._loads.of_chain(yielding, coordinates)
            force, moment = loads.seen_from(self._mount.frame(yielding, coordinates))
            tilt = self._tilting * (moment - cross(self._point, force))
            shift = self._along * force - cross(tilt, self._point)
            moved = Fixed(_turned_by(tilt), shift)
            yielding = self._mount.displaced(geometry, coordinates, moved)
        return cast(Geometry, yielding)


def has_fixture(rig: Rig) -> bool:
    """Whether something holds the end of the chain, or a pivot the plate."""
    if isinstance(rig.mechanism, PlatformMechanism):
        return rig.mechanism.plate == "pivoted"
    return not {"x", "y", "z"} <= rig.mechanism.closure.freedoms


def mount_of(rig: Rig, values: Mapping[str, float]) -> Mount | None:
    """The mount of a chain of joints, or None of a platform."""
    chain = rig.mechanism
    return None if isinstance(chain, PlatformMechanism) else Mount(chain, values)


def _turned_by(vector: Array) -> Array:
    """Turns (n, 4) by rotation vectors (n, 3) [rad]."""
    angle = np.linalg.norm(vector, axis=1)
    axis = np.divide(vector, angle[:, None], out=np.zeros_like(vector), where=angle[:, None] > 0)
    return about(axis, angle)
