"""Undoing effects at channels: tables from what a channel reads to what is true.

A controller can undo an effect that depends on its channel's own value alone. Owns those tables;
refuses effects that depend on load, time, direction or other channels, or sit in the geometry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.effects.effect import Effect, Site
from solver.effects.grown import Grown
from solver.errors import NotEnoughData
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import Model

Array = NDArray[np.float64]

_ON = {
    "time_s": "the time since the session began, so that any table would hold for one moment only",
    "approach": "the side from which a position was reached",
    "rate": "speed",
    "torque": "load",
    "moment": "load",
    "force": "load",
}
_POINTS = 721  # half a degree apart over a turn


@dataclass(frozen=True, slots=True)
class Correction:
    """What is ``true`` (Q,) where a channel with straight gain and offset says ``read`` (Q,) [rad or m]."""

    read: Array
    true: Array


def corrections(model: Model, parameters: Array) -> Mapping[str, Correction]:
    """Tables for the channels that have effects; between their points a straight line will do.

    They cover the channel's range of counts, or one turn where it has none.

    Raises:
        NotEnoughData: an effect that no channel can undo by itself.
    """
    if not isinstance(model, Grown):
        return {}
    out: dict[str, Correction] = {}
    site = model.site
    for name in dict.fromkeys(effect.where for effect in model.effects):
        there = [
            (effect, parameters[columns])
            for effect, columns in zip(model.effects, model.columns, strict=True)
            if effect.where == name
        ]
        for effect, _ in there:
            _require_own(site, effect)
        low, high = site.spans.get(name, (-np.pi, np.pi))
        true = np.linspace(low, high, _POINTS)
        values = np.zeros((_POINTS, len(model.channels)))
        values[:, site.channel(name)] = true
        read = true.copy()
        for effect, coefficients in there:
            shift = effect.seen(values, coefficients, Circumstances())
            if shift is not None:
                read = read + shift.amount[:, 0]
        out[name] = Correction(read, true)
    return out


def _require_own(site: Site, effect: Effect) -> None:
    names = [channel.name for channel in site.rig.channels]
    if effect.where in names and not effect.needs:
        probe = np.zeros((1, len(names)))
        start = np.array([c.start for c in effect.coefficients])
        shift = effect.seen(probe, start, Circumstances())
        if shift is not None and shift.targets.tolist() == [names.index(effect.where)]:
            return
    more = [_ON[field] for field in effect.needs if field in _ON]
    depends = f"it depends on {' and '.join(more)}" if more else "it is not at that channel alone"
    raise NotEnoughData(
        f"the effect '{effect.label}' cannot be undone by a table for one channel: {depends}. "
        "Use the calibrated rig (--rig-out), which describes it."
    )
