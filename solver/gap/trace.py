"""The trace that an effect would leave: change of the whitened residual, poses' coordinates following.

Linear in the coefficients about a fit. Owns how each kind of effect (seen, moved, coded) becomes
columns; a coded effect, which has no small form, gets one column: all of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solver.effects.effect import Effect
from solver.estimate.nuisance import eliminated
from solver.gap.fit import Fit
from solver.mechanism.model import mechanism_model

Array = NDArray[np.float64]


def traces(fit: Fit, effects: Sequence[Effect], values: Array | None = None) -> list[Array]:
    """For each effect (P C, k): what it adds to measured - predicted for each unit coefficient [1/SI].

    Args:
        fit: where all is linearised.
        effects: of interest.
        values: (P, C) true values by which the effects see; those of ``fit`` by default.
    """
    model, at = fit.model, fit.at
    here = model.linearise(
        fit.settled.coordinates, fit.parameters, np.zeros((len(fit.parameters), 0)), at
    )
    poses, channels = here.readings.shape
    closures = here.closure.shape[1]
    gain = fit.parameters[model.sensing.gain]
    values = fit.values if values is None else values
    moved = [effect.moved(_start(effect), at, poses) for effect in effects]
    targets = np.unique(
        np.concatenate([np.zeros(0, dtype=np.intp), *(m.targets for m in moved if m is not None)])
    )
    readings_by, closure_by = _by_parameters(fit, targets)
    by_readings: list[Array] = []
    by_closure: list[Array] = []
    widths: list[int] = []
    for effect, move in zip(effects, moved, strict=True):
        k = len(effect.coefficients)
        coded = effect.coded(here.readings, _start(effect), at)
        D = np.zeros((poses, channels, 1 if coded is not None else k))
        Cx = np.zeros((poses, closures, D.shape[2]))
        seen = effect.seen(values, _start(effect), at)
        if seen is not None:
            D[:, seen.targets] += seen.by_coefficients / gain[seen.targets][:, None]
        if move is not None:
            place = np.searchsorted(targets, move.targets)
            by_coefficients = move.absolute(fit.parameters)
            D += readings_by[:, :, place] @ by_coefficients
            Cx += closure_by[:, :, place] @ by_coefficients
        if coded is not None:
            D[:, coded.channel, 0] += coded.counts - here.readings[:, coded.channel]
        by_readings.append(D)
        by_closure.append(Cx)
        widths.append(D.shape[2])
    if not widths:
        return []
    residual, _ = eliminated(
        here,
        fit.observed,
        np.concatenate(by_readings, axis=2),
        np.concatenate(by_closure, axis=2),
    )
    flat = -residual.reshape(poses * channels, -1)
    return np.split(flat, np.cumsum(widths)[:-1], axis=1)


def codes(fit: Fit, effect: Effect) -> bool:
    """Whether ``effect`` changes codes, and so has no small form."""
    return effect.coded(fit.observed.counts, _start(effect), fit.at) is not None


def _start(effect: Effect) -> Array:
    return np.array([c.start for c in effect.coefficients])


def _by_parameters(fit: Fit, targets: NDArray[np.intp]) -> tuple[Array, Array]:
    """Derivatives (P, C, T) and (P, K, T) of the mechanism with parameters and imperfections."""
    site, x = fit.model.site, fit.parameters
    plain = mechanism_model(site.rig, site.table, imperfect=True)
    full = np.concatenate([x[: fit.model.named], np.zeros(len(site.names) - fit.model.named)])
    directions = np.zeros((len(full), len(targets)))
    directions[targets, np.arange(len(targets))] = 1.0
    at = plain.linearise(fit.settled.coordinates, full, directions, fit.observed.at)
    return at.readings_by_parameters, at.closure_by_parameters
