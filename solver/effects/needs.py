"""What the effects of a model ask of a recording: loads, readings in motion, and enough variety.

Owns when loads are computed and what is refused: an effect that is to be identified from a
recording that cannot show it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig
from solver.effects.grown import Grown
from solver.effects.registry import effect_kinds
from solver.errors import NotEnoughData
from solver.estimate.nuisance import Observations
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import Model
from solver.mechanism.space import ParameterSpace
from solver.mechanism.statics import loads

Array = NDArray[np.float64]

_LOADS = frozenset({"torque", "force"})


def needs(rig: Rig) -> frozenset[str]:
    """Fields of `Circumstances` that the effects of ``rig`` depend on; unknown effects need nothing."""
    kinds = effect_kinds() if rig.effects else {}
    return frozenset(field for e in rig.effects if e.name in kinds for field in kinds[e.name].needs)


def loaded(
    model: Model,
    observed: Observations,
    coordinates: Array,
    parameters: Array,
    held: NDArray[np.bool_] | None,
) -> Observations:
    """``observed`` with loads, where an effect of ``model`` needs them; else as it is.

    Args:
        model: with or without effects.
        observed: P poses.
        coordinates: (P, U) where they are.
        parameters: (N,).
        held: (P, J) whether a drive held each joint; None where nobody knows.
    """
    if not isinstance(model, Grown):
        return observed
    if not any(_LOADS & set(effect.needs) for effect in model.effects):
        return observed
    at = observed.at or Circumstances()
    found = loads(model.site.rig, coordinates, parameters[: model.named], held, at)
    return replace(observed, at=at.loaded(found.torque, found.force))


def require_shown(model: Model, space: ParameterSpace, at: Circumstances | None) -> None:
    """Refuse what the circumstances cannot show or leave unknown.

    Raises:
        NotEnoughData: an effect is to be identified that these circumstances cannot show, or is
            described by something that nobody knows of them.
    """
    if not isinstance(model, Grown):
        return
    known = at or Circumstances()
    identified = set(space.identified.tolist())
    for effect, columns in zip(model.effects, model.columns, strict=True):
        wanted = bool(identified & set(columns.tolist()))
        unknown = any(getattr(known, field) is None for field in effect.needs)
        why = effect.untestable(model.site, effect.where, known)
        if why is not None and (wanted or unknown):
            verb = "cannot be identified from" if wanted else "cannot be computed for"
            raise NotEnoughData(
                f"the effect '{effect.label}' {verb} this recording: {why}. Record that, or take the effect "
                "out of the rig."
            )
