"""``link-geometry``: a parameter of the mechanism that is held fixed is not what the rig says.

Size: by how much it is larger [deg or m]. What is tied to it follows. Axes that are stated to
meet are left to ``axis-offset``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Parameter, Rig, SerialMechanism, parameters
from sim_devices.plant.effects.axis_offset import meeting_axes
from sim_devices.plant.effects.described import check_place, read_values, told
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import number_size

_MOST = {"length": 0.1, "angle": 20.0}


class LinkGeometry(Effect):
    """A wrong parameter.

    Args:
        where: parameter.
        size: by how much it is larger [``unit``].
        unit: "deg" or "m".
        moves: by how much it and its followers are larger, SI, by name.
    """

    name = "link-geometry"

    def __init__(self, where: str, size: float, unit: str, moves: Mapping[str, float]) -> None:
        super().__init__(where, size, unit)
        self._moves = moves

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        meeting = {f"{joint}.a" for joint in meeting_axes(rig)}
        return tuple(
            name
            for name, p in _geometry(rig).items()
            if not p.identify and name not in meeting and _shows(rig, name)
        )

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        length = _geometry(rig)[where].dimension == "length"
        size = rng.uniform(0.5e-3, 5e-3) if length else rng.uniform(0.1, 1.0)
        return f"{rng.choice([-1, 1]) * size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        parameter = _geometry(request.rig)[request.where]
        size = number_size(
            cls.name, request.size, parameter.unit, _MOST[parameter.dimension], signed=True
        )
        moves = _moves(request.rig, request.where, size * parameter.to_si)
        return cls(request.where, size, parameter.unit, moves)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        known = _geometry(rig)
        check_place(effect, tuple(known))
        dimension = known[effect.where].dimension
        change = read_values(effect, values, {"change": dimension})["change"]
        return cls(effect.where, *told(dimension, change), _moves(rig, effect.where, change))

    def values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        moved = {name: values[name] + change for name, change in self._moves.items()}
        return {**values, **moved}


def _geometry(rig: Rig) -> dict[str, Parameter]:
    """Parameters of the mechanism that are not tied, by name."""
    mechanism = rig.mechanism
    if isinstance(mechanism, SerialMechanism):
        owners = {*mechanism.places, *mechanism.fixture_names, "tip"}
    else:
        owners = {point.name for point in (*mechanism.base_points, *mechanism.plate_points)}
    return {
        p.name: p
        for p in parameters(rig)
        if p.tie is None and "@" not in p.name and p.name.rpartition(".")[0] in owners
    }


def _shows(rig: Rig, name: str) -> bool:
    """False for what cannot show: the zero of an unsensed joint, the turn of a ball's socket."""
    mechanism = rig.mechanism
    if not isinstance(mechanism, SerialMechanism):
        return True
    owner, _, part = name.rpartition(".")
    if part == "theta_offset":
        return rig.sensed_by(owner) is not None
    return not (owner in mechanism.fixture_names and part in mechanism.closure.freedoms)


def _moves(rig: Rig, name: str, change: float) -> dict[str, float]:
    moves = {name: change}
    for p in parameters(rig):
        if p.tie is not None and p.tie.parameter == name:
            moves[p.name] = p.tie.factor * change
    return moves
