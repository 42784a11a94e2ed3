"""``bearing-compliance``: a joint gives way across its axis, under what leans on it.

All that is behind the joint tilts, as the moment about the joint's origin would have it, its share
along the axis left out; the bearing is equally soft all round. The tilt is a turn of the chain's
frame ahead of the joint, which no sensor sees.

Hidden, the bearing hardens a little: it yields c M asinh(m / M) under a moment m, where M is six
times the greatest at the plan's stops. Size: the slope of the best straight line of tilt over moment, as
vectors, at the plan's stops [deg/Nm]. Described, it yields compliance times moment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Self, cast

import numpy as np

from recordings.rig import DescribedEffect, Rig, SerialMechanism
from sim_devices.plant.chain import ChainGeometry, Fixed, chain_geometry
from sim_devices.plant.effects.described import check_place, read_values, told
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.loads import Loads, loads_of
from sim_devices.plant.effects.rms import slope
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.quaternion import IDENTITY, Array

_DIMENSION = "angular compliance"
_UNIT = "deg/Nm"
_ROUNDS = 3
"""The tilt moves the links, and so what leans on the joint."""
_MOST = 1.0

Spring = Callable[[Array], Array]
"""Tilt (n,) [rad] under moments (n,) of 0 and above [Nm]."""


class BearingCompliance(Effect):
    """A soft bearing.

    Args:
        where: joint.
        size: compliance [deg/Nm].
        place: number of the joint.
        spring: how it yields.
        loads: gives what leans on it.
    """

    name = "bearing-compliance"
    steady = True

    def __init__(
        self, where: str, size: float, *, place: int, spring: Spring, loads: Loads
    ) -> None:
        super().__init__(where, size, _UNIT)
        self._place, self._spring, self._loads = place, spring, loads

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        mechanism = rig.mechanism
        if not isinstance(mechanism, SerialMechanism) or not Loads.known(rig):
            return ()
        return tuple(
            joint.name
            for joint in mechanism.joints
            if joint.type == "revolute" and rig.sensed_by(joint.name) is not None
        )

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(1e-3, 2e-2):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        rig, where = request.rig, request.where
        assert isinstance(rig.mechanism, SerialMechanism)
        size = number_size(cls.name, request.size, _UNIT, _MOST)
        compliance = size / told(_DIMENSION, 1.0)[0]
        place, loads = rig.mechanism.places.index(where), loads_of(rig, request.values)
        chain = chain_geometry(
            rig.mechanism, request.values, (rig.mechanism.fixture_names or (None,))[0]
        )
        leaning = loads.of_chain(chain, request.rests().coordinates).leaning[:, place, :2]
        moment = np.linalg.norm(leaning, axis=1)
        if not moment.any():
            raise BadEffect(f"no weight leans on '{where}', so that its bearing cannot yield")
        hard = 6 * float(moment.max())

        def bare(moment: Array) -> Array:
            return np.asarray(hard * np.arcsinh(moment / hard))

        tilt = (bare(moment) / np.where(moment > 0, moment, 1.0))[:, None] * leaning
        centred = [(each - each.mean(axis=0)).ravel() for each in (leaning, tilt)]
        factor = compliance / (slope(*centred) or 1.0)
        return cls(
            where, size, place=place, spring=lambda moment: factor * bare(moment), loads=loads
        )

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        compliance = read_values(effect, values, {"compliance": _DIMENSION})["compliance"]
        return cls(
            effect.where,
            told(_DIMENSION, compliance)[0],
            place=rig.mechanism.places.index(effect.where),
            spring=lambda moment: compliance * moment,
            loads=loads_of(rig, values),
        )

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        if not isinstance(geometry, ChainGeometry):
            return geometry
        tilted: ChainGeometry = geometry
        for _ in range(_ROUNDS):
            leaning = self._loads.of_chain(tilted, coordinates).leaning[:, self._place, :2]
            moment = np.linalg.norm(leaning, axis=1)
            share = self._spring(moment) / np.where(moment > 0, moment, 1.0)
            tilted = self._tilted(geometry, share[:, None] * leaning, coordinates.shape)
        return cast(Geometry, tilted)

    def _tilted(
        self, geometry: ChainGeometry, tilt: Array, shape: tuple[int, ...]
    ) -> ChainGeometry:
        """``geometry`` turned by ``tilt`` (n, 2) [rad] about x and y of the frame before the joint."""
        turned = _small_turn(tilt)
        if self._place == 0:
            seat = geometry.seat or Fixed(IDENTITY, np.zeros(3))
            return replace(geometry, seat=seat.then(Fixed(turned, np.zeros(3))))
        links = geometry.links or Fixed(IDENTITY, np.zeros(3))
        turns = np.broadcast_to(links.turn, (*shape, 4)).copy()
        shifts = np.broadcast_to(links.shift, (*shape, 3))
        before = self._place - 1
        bent = Fixed(turns[:, before], shifts[:, before]).then(Fixed(turned, np.zeros(3)))
        turns[:, before] = bent.turn
        return replace(geometry, links=Fixed(turns, shifts))


def _small_turn(tilt: Array) -> Array:
    """Quaternions (n, 4) of the rotation vectors (x, y, 0) [rad]."""
    angle = np.linalg.norm(tilt, axis=1)
    half = 0.5 * np.sinc(angle / (2 * np.pi))
    out = np.zeros((len(tilt), 4))
    out[:, 0] = np.cos(angle / 2)
    out[:, 1:3] = half[:, None] * tilt
    return out
