"""``cyclic-error``: n periods per revolution, as the teeth of a gear or the poles of a resolver make.

Teeth are not sine waves: hidden, a twentieth comes at twice the harmonic. Size: RMS about the
mean over the plan's stops [deg or m]; how many periods is drawn. Described, there is one harmonic.
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
from sim_devices.plant.errors import BadEffect

_HARMONICS = (2, 3, 4, 6, 8, 12, 16)
_PEAKED = 0.05
"""Second harmonic of the error over its first."""


class CyclicError(Periodic):
    """An error of teeth or poles."""

    name = "cyclic-error"

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        angular = channel_dimension(rig, where) == "angle"
        size = rng.uniform(0.01, 0.1) if angular else rng.uniform(0.01e-3, 0.1e-3)
        return f"{size:.4g}"

    @classmethod
    def make(cls, request: Request) -> Self:
        harmonic = float(request.rng.choice(_HARMONICS))
        first, second = request.rng.uniform(0.0, 2 * np.pi, 2)
        waves = [
            (harmonic, np.cos(first), np.sin(first)),
            (2 * harmonic, _PEAKED * np.cos(second), _PEAKED * np.sin(second)),
        ]
        size, waves = scaled_waves(cls.name, request, waves)
        unit, _ = channel_unit(request.rig, request.where)
        return cls(request.where, size, unit, turning_of(request.rig, request.where), waves)

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, cls.places(rig))
        dimension = channel_dimension(rig, effect.where)
        parts = {"cos": dimension, "sin": dimension}
        true = read_values(effect, values, parts, {"harmonic": "ratio"})
        if true["harmonic"] <= 0:
            raise BadEffect(f"the effect '{effect.label}' has a harmonic that is not above 0")
        unit, to_si = channel_unit(rig, effect.where)
        waves = [(true["harmonic"], true["cos"], true["sin"])]
        size = described_size(true, to_si)
        return cls(effect.where, size, unit, turning_of(rig, effect.where), waves)
