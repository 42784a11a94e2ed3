"""``outsider:bending-leg``: a leg bends as it is swung away from where it hangs straight.

A bent leg's ends are nearer to each other than it is long, by what grows with the square of the
sine of the angle from its mean direction. Size: RMS of that about the mean over
the plan's stops [m].
"""

from __future__ import annotations

from dataclasses import replace
from typing import Self, cast

import numpy as np

from recordings.rig import PlatformMechanism, Rig
from sim_devices.plant.effects.effect import Effect, Geometry, Request
from sim_devices.plant.effects.rms import rms_about_mean
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.plate import PlateGeometry, plate_geometry
from sim_devices.plant.quaternion import Array, turn


class BendingLeg(Effect):
    """A leg that bends.

    Args:
        where: leg.
        size: RMS about the mean over the plan's stops [m].
        leg: its number.
        straight: (3,) unit vector along it where it does not bend.
        shortening: at a right angle to that [m].
    """

    name = "outsider:bending-leg"
    steady = True

    def __init__(
        self, where: str, size: float, *, leg: int, straight: Array, shortening: float
    ) -> None:
        super().__init__(where, size, "m")
        self._leg, self._straight, self._shortening = leg, straight, shortening

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return rig.mechanism.places if isinstance(rig.mechanism, PlatformMechanism) else ()

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.05e-3, 0.3e-3):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        size = number_size(cls.name, request.size, "m", most=0.01)
        mechanism = request.rig.mechanism
        if not isinstance(mechanism, PlatformMechanism):
            raise BadEffect(f"'{cls.name}' needs a platform")
        leg = mechanism.places.index(request.where)
        along = _along(plate_geometry(mechanism, request.values), request.rests().coordinates, leg)
        straight = along.mean(axis=0)
        straight /= np.linalg.norm(straight)
        rms = rms_about_mean(_bent(along, straight))
        if not rms > 0.0:
            raise BadEffect(f"the plan does not swing '{request.where}', so it cannot bend")
        return cls(request.where, size, leg=leg, straight=straight, shortening=size / rms)

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        if not isinstance(geometry, PlateGeometry):
            return geometry
        along = _along(geometry, coordinates, self._leg)
        shorter = self._shortening * _bent(along, self._straight)
        base = np.broadcast_to(geometry.base, (len(along), *geometry.base.shape[-2:])).copy()
        # The sensor beside the leg measures it along its bow: it is longer than its ends are apart.
        base[:, self._leg] += shorter[:, None] * along
        return cast(Geometry, replace(geometry, base=base))


def _along(geometry: PlateGeometry, coordinates: Array, leg: int) -> Array:
    """(n, 3) unit vectors from the plate end of a leg to its base end."""
    ends = turn(coordinates[:, :4], geometry.plate[..., leg, :]) + coordinates[:, 4:]
    way = geometry.base[..., leg, :] - ends
    return np.asarray(way / np.linalg.norm(way, axis=-1, keepdims=True))


def _bent(along: Array, straight: Array) -> Array:
    """(n,) squared sine of the angle to ``straight``."""
    return np.asarray(1 - (along @ straight) ** 2)
