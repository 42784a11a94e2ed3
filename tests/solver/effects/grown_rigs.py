"""Averaged poses of an arm whose sensors have effects, made from the solver's own model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recordings.rig import Rig
from solver.effects.effect import Site
from solver.effects.registry import effect_kinds
from solver.samples import PoseTable
from tests.solver.synthetic import pose_table


def recorded(rig: Rig, *coefficients: float, poses: int) -> PoseTable:
    """Dwells of the bundled arm, not at its nominal parameters, with the one effect of ``rig`` [SI]."""
    (described,) = rig.effects
    effect = effect_kinds()[described.name].read(Site(rig), described)
    table = pose_table("arm", seed=4, poses=poses)
    gain, zero = np.array([(c.gain.nominal, c.zero_count) for c in rig.channels]).T
    values = gain * (table.counts - zero)
    shift = effect.seen(values, np.array(coefficients), table.circumstances(rig))
    assert shift is not None
    counts = table.counts.copy()
    counts[:, shift.targets] += shift.amount / gain[shift.targets]
    return replace(table, counts=counts)
