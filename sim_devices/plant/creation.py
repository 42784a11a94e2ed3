"""Making nature out of a rig description: draw its truth, then hide effects in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.effect import Rests
from sim_devices.plant.effects.registry import hidden_effects
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.loop import Loop
from sim_devices.plant.nature import Nature, nature_of
from sim_devices.plant.seeds import ASSEMBLY, stream
from sim_devices.plant.session import rests
from sim_devices.truth import draw_truth

_UNPLANNED_S = 600.0
_UNPLANNED_STOPS = 100
"""What a session is taken for where the rig has no plan."""


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
    effects = hidden_effects(hide, rig, seed, values, lambda: _rests(bare, poses))
    for effect in effects:
        values = effect.values(values)
    told = tuple(effect.told for effect in effects)
    truth = replace(bare.truth, parameters=MappingProxyType(dict(values)), effects=told)
    return nature_of(rig, truth, effects)


def _rests(bare: Nature, poses: int | None) -> Rests:
    """The stops of the plan; where there is none, a slow course over full scale."""
    if bare.rig.plan is not None:
        return rests(bare, poses)
    spans = {name: sensor.span or (-1.0, 1.0) for name, sensor in bare.sensors.items()}
    mechanism = bare.mechanism
    if isinstance(mechanism, Loop):
        coordinates = mechanism.assemble(stream(bare.truth.seed, ASSEMBLY))
    else:
        coordinates = np.hstack([mechanism.neutral_turn, mechanism.neutral_shift])
    return Rests(
        np.linspace(0.0, _UNPLANNED_S, _UNPLANNED_STOPS),
        {name: np.linspace(*span, _UNPLANNED_STOPS) for name, span in spans.items()},
        coordinates[None],
        _UNPLANNED_S,
    )
