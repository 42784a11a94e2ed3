"""Making nature out of a rig description: draw its truth, then hide effects in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.registry import hidden_effects
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.nature import Nature, nature_of
from sim_devices.plant.quaternion import Array
from sim_devices.plant.session import resting
from sim_devices.truth import draw_truth


def make_nature(rig: Rig, seed: int, hide: Sequence[str] = (), poses: int | None = None) -> Nature:
    """Draw the truth of ``rig`` and hide effects in it.

    Args:
        rig: as described.
        seed: 0 or above.
        hide: effects, each ``NAME@WHERE=SIZE`` or ``random``.
        poses: number of distinct poses, in place of the plan's own; effects that are sized
            by the plan's travel are sized by theirs.

    Raises:
        BadEffect: an effect that is misspelled or cannot be.
        CannotSimulate: a seed below 0; or an effect is sized by the plan's travel, and this
            mechanism cannot carry out the plan.
        MechanismDoesNotClose: the same, where the loop does not close.
    """
    if seed < 0:
        raise CannotSimulate(f"the seed is {seed}, expected 0 or above")
    bare = nature_of(rig, draw_truth(rig, seed))
    values = bare.truth.parameters
    effects = hidden_effects(hide, rig, seed, values, lambda: _travel(bare, poses))
    for effect in effects:
        values = effect.values(values)
    told = tuple(effect.told for effect in effects)
    truth = replace(bare.truth, parameters=MappingProxyType(dict(values)), effects=told)
    return nature_of(rig, truth, effects)


def _travel(bare: Nature, poses: int | None) -> Mapping[str, Array]:
    """Values of each channel at the stops of the plan; over full scale where there is no plan."""
    if bare.rig.plan is not None:
        return resting(bare, poses)
    spans = {name: sensor.span or (-1.0, 1.0) for name, sensor in bare.sensors.items()}
    return {name: np.linspace(*span, 100) for name, span in spans.items()}
