"""``fixture-slip``: the fixture, or the pivot of a plate, moved at one moment.

Hidden, it happens somewhere in the middle half of the session; a fixture is also turned a little,
by up to the angle of its displacement at `_LEVER_M`. Size: the length of the displacement [m]; its
direction is drawn. Hidden and described are otherwise alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Self, cast

import numpy as np

from recordings.rig import POSE, DescribedEffect, PlatformMechanism, Rig
from sim_devices.plant.chain import ChainGeometry, Fixed, pose
from sim_devices.plant.effects.described import check_place, read_values
from sim_devices.plant.effects.effect import Effect, Geometry, Request, moment_within
from sim_devices.plant.effects.fixture_compliance import FIXTURE, has_fixture, mount_of
from sim_devices.plant.effects.mount import Mount
from sim_devices.plant.effects.size import number_size
from sim_devices.plant.plate import PlateGeometry
from sim_devices.plant.quaternion import IDENTITY, Array

_LEVER_M = 0.3


class FixtureSlip(Effect):
    """A fixture that slips.

    Args:
        size: length of the displacement [m].
        parts: (6,) x, y, z [m], rx, ry, rz [rad], in the mount's frame; of a pivot in the base frame.
        at_s: when.
        mount: of a chain.
    """

    name = "fixture-slip"

    def __init__(self, size: float, parts: Array, at_s: float, mount: Mount | None) -> None:
        super().__init__(FIXTURE, size, "m")
        self._mount = mount
        self._moved = pose(parts.tolist())
        self._at_s = at_s

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return (FIXTURE,) if has_fixture(rig) else ()

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.2e-3, 2e-3):.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        size = number_size(cls.name, request.size, "m", most=0.1)
        way = request.rng.standard_normal((2, 3)) * _held(request.rig)
        shift = size * way[0] / np.linalg.norm(way[0])
        length = float(np.linalg.norm(way[1]))
        turned = size / _LEVER_M * request.rng.uniform() * way[1] / length if length else way[1]
        mount = mount_of(request.rig, request.values)
        return cls(size, np.concatenate([shift, turned]), moment_within(request), mount)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        parts = dict.fromkeys(POSE[:3], "length")
        if not isinstance(rig.mechanism, PlatformMechanism):
            parts |= dict.fromkeys(POSE[3:], "angle")
        true = read_values(effect, values, parts, {"at": "time"})
        moved = np.array([true.get(part, 0.0) for part in POSE])
        return cls(float(np.linalg.norm(moved[:3])), moved, true["at"], mount_of(rig, values))

    def geometry(self, geometry: Geometry, time_s: Array, coordinates: Array) -> Geometry:
        slipped = (time_s >= self._at_s)[:, None]
        shift = np.where(slipped, self._moved.shift, 0.0)
        if isinstance(geometry, PlateGeometry):
            return replace(geometry, base=geometry.base - shift[:, None])
        if not isinstance(geometry, ChainGeometry) or self._mount is None:
            return geometry
        moved = Fixed(np.where(slipped, self._moved.turn, IDENTITY), shift)
        return cast(Geometry, self._mount.displaced(geometry, coordinates, moved))


def _held(rig: Rig) -> Array:
    """(2, 3) one for each shift and turn in which the end is held, else 0."""
    if isinstance(rig.mechanism, PlatformMechanism):
        return np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    free = rig.mechanism.closure.freedoms
    return np.array([float(part not in free) for part in POSE]).reshape(2, 3)
