"""``eccentricity``: the disc of a sensor turns about a centre beside its own; once per revolution.

A disc with its centre e beside the axis, read at radius r, errs by (e / r) cos(phi - phi_0); a
disc that is clamped off centre is also bent oval, which adds a second harmonic of a tenth. Size:
RMS about the mean over the plan's stops [deg or m]. Described, there is the first harmonic only.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import channel_dimension, check_place, read_values
from sim_devices.plant.effects.effect import Request
from sim_devices.plant.effects.periodic import Periodic, described_size, scaled_waves, turning_of
from sim_devices.plant.effects.size import channel_unit

_OVAL = 0.1
"""Second harmonic over the first."""


class Eccentricity(Periodic):
    """An eccentric disc."""

    name = "eccentricity"

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where) == "angle"
        size = rng.uniform(0.02, 0.3) if angular else rng.uniform(0.02e-3, 0.2e-3)
        return f"{size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        first, second = request.rng.uniform(0.0, 2 * np.pi, 2)
        waves = [
            (1.0, np.cos(first), np.sin(first)),
            (2.0, _OVAL * np.cos(second), _OVAL * np.sin(second)),
        ]
        size, waves = scaled_waves(cls.name, request, waves)
        unit, _ = channel_unit(request.rig, request.where)
        return cls(request.where, size, unit, turning_of(request.rig, request.where), waves)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        dimension = channel_dimension(rig, effect.where)
        true = read_values(effect, values, {"cos": dimension, "sin": dimension})
        unit, to_si = channel_unit(rig, effect.where)
        waves = [(1.0, true["cos"], true["sin"])]
        size = described_size(true, to_si)
        return cls(effect.where, size, unit, turning_of(rig, effect.where), waves)
