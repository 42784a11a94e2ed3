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

_LOADS = frozenset({"torque", "moment", "force"})


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
    return replace(observed, at=at.loaded(found.torque, found.force, found.moment))


def require_shown(model: Model, space: ParameterSpace, at: Circumstances | None) -> None:
    """Refuse to identify what these circumstances cannot show.

    Raises:
        NotEnoughData: an effect is to be identified that these circumstances cannot show, or is
            described by something that nobody knows of them.
    """
    require_known(model, at)
    if not isinstance(model, Grown):
        return
    identified = set(space.identified.tolist())
    for effect, columns in zip(model.effects, model.columns, strict=True):
        why = effect.untestable(model.site, effect.where, at or Circumstances())
        if why is not None and identified & set(columns.tolist()):
            raise NotEnoughData(
                f"the effect '{effect.label}' cannot be identified from this recording: {why}. Record that, or "
                "hold the effect (identify = false), or take it out of the rig."
            )


def require_known(model: Model, at: Circumstances | None) -> None:
    """Refuse to compute an effect from what nobody knows.

    Raises:
        NotEnoughData: an effect depends on circumstances that are not known.
    """
    if not isinstance(model, Grown):
        return
    known = at or Circumstances()
    for effect in model.effects:
        unknown = [field for field in effect.needs if getattr(known, field) is None]
        if unknown:
            why = effect.untestable(model.site, effect.where, known)
            raise NotEnoughData(
                f"the effect '{effect.label}' cannot be computed for this recording: "
                f"{why or 'nobody knows ' + ', '.join(unknown)}. Record that, or take the effect out of the rig."
            )


def generic(
    rig: Rig, model: Model, coordinates: Array, parameters: Array, *, seed: int = 0
) -> Circumstances | None:
    """Circumstances of poses (P, U) such as a session might meet, to see what they would determine.

    A pose a second, reached from either side, standing still, its joints held as planned.
    """
    if not isinstance(model, Grown):
        return None
    poses, channels = len(coordinates), len(rig.channels)
    at = Circumstances(
        time_s=np.arange(poses, dtype=np.float64),
        approach=np.random.default_rng(seed).choice([-1.0, 1.0], (poses, channels)),
        rate=np.zeros((poses, channels)),
        noise=np.tile([max(c.noise, 0.3) for c in rig.channels], (poses, 1)),
    )
    held = None
    if rig.plan is not None and rig.plan.drives:
        held = np.tile([place in rig.plan.drives for place in rig.mechanism.places], (poses, 1))
    nothing = np.zeros((poses, channels))
    found = loaded(model, Observations(nothing, nothing, at), coordinates, parameters, held)
    return found.at
