"""What a search found, in the user's terms: effects with sizes, errors, rivals and stand-ins.

Owns how a fitted effect becomes a line of the answer, whether it came from the search or from raw
codes. What is named, and whether anything is, is decided elsewhere.
"""

from __future__ import annotations

import numpy as np

from recordings.rig import DescribedEffect
from solver.effects.effect import Array
from solver.effects.link_geometry import LinkGeometry, twins
from solver.effects.registry import effect_kinds
from solver.gap.channels import disagreement
from solver.gap.fit import Fit, without
from solver.gap.result import MissingEffect, Rival
from solver.gap.search import Named, Possible, Search
from solver.gap.trace import traces

_ROUNDING = 12.0**-0.5  # counts
_STEP = 1e-4  # of a standard error, for the derivative of a size


def defect(plain: Fit, fit: Fit, entry: DescribedEffect) -> MissingEffect:
    """A defect of a converter, known from raw codes to the count."""
    effect = effect_kinds()[entry.name].read(fit.model.site, entry)
    noise = fit.rss / max(fit.freedoms, 1)
    coefficients = np.array([entry.values[c.name].nominal for c in effect.coefficients])
    channel = fit.model.channels.index(effect.where)
    size = effect.size(coefficients, fit.values, fit.at)
    # How far the travel goes beyond a rail is known as well as the rest of the loop knows the channel.
    gain = abs(fit.parameters[fit.model.sensing.gain[channel]])
    beyond = disagreement(fit).standard_error[:, channel] * effect.to_si
    own = gain * fit.observed.sigma[:, channel]
    predicted = np.sqrt(np.maximum(beyond**2 - own**2, 0.0))
    error = 0.0
    if entry.name == "saturation":
        counts = (fit.observed.counts - fit.residual * fit.observed.sigma)[:, channel]
        over = np.stack(
            [
                counts - value.nominal if side == "high" else value.nominal - counts
                for side, value in entry.values.items()
            ]
        ).max(axis=0)
        farthest = int(np.argmax(over))
        # A rail lies anywhere within the code that it shows.
        size = float(gain) * max(float(over[farthest]), 0.0)
        error = float(np.hypot(predicted[farthest], gain * _ROUNDING))
    return MissingEffect(
        effect.name,
        effect.where,
        size / effect.to_si,
        error / effect.to_si,
        effect.unit,
        (),
        max(plain.rss - fit.rss, 0.0) / max(noise, 1e-300),
        1.0,
        entry,
    )


def missing(found: Search, number: int) -> MissingEffect:
    """One effect that a search named."""
    named = found.named[number]
    size, error = _size(named.best)
    effect = named.best.effect
    fit = named.best.after.fit
    last = len(fit.effects) - 1
    scale = float(np.sqrt(fit.rss / max(fit.freedoms, 1)))
    return MissingEffect(
        effect.name,
        effect.where,
        size,
        error,
        effect.unit,
        (
            *_stand_ins(named.best, 0.0),
            *(_rival(named, rival) for rival in named.rivals),
            *(twin for rival in named.rivals for twin in _stand_ins(rival, _apart(named, rival))),
        ),
        named.best.explained,
        named.best.retained,
        effect.entry(fit.coefficients(last).tolist(), fit.standard_errors(last, scale).tolist()),
    )


def _rival(named: Named, rival: Possible) -> Rival:
    size, error = _size(rival)
    effect = rival.effect
    return Rival(effect.name, effect.where, _apart(named, rival), size, error, effect.unit)


def _apart(named: Named, rival: Possible) -> float:
    """Log evidence of ``rival`` against what is named."""
    return rival.log_evidence - named.best.log_evidence


def _stand_ins(possible: Possible, apart: float) -> tuple[Rival, ...]:
    """Parameters that no reading tells from the one of ``possible``, for which it stood in the search."""
    effect, fit = possible.effect, possible.after.fit
    if effect.name != LinkGeometry.name:
        return ()
    site = fit.model.site
    others = [LinkGeometry(site, name) for name in twins(site).get(effect.where, ())]
    if not others:
        return ()
    size, error = _size(possible)
    before = without(fit, len(fit.effects) - 1)
    if before is None:
        return ()
    # What parameters absorb of each need not be alike; what they leave is.
    mine, *theirs = (before.projected(t)[:, 0] for t in traces(before, [effect, *others]))
    factors = [float(mine @ their) / max(float(their @ their), 1e-300) for their in theirs]
    return tuple(
        Rival(
            other.name,
            other.where,
            apart,
            size * effect.to_si * factor / other.to_si,
            error * effect.to_si * abs(factor) / other.to_si,
            other.unit,
        )
        for other, factor in zip(others, factors, strict=True)
    )


def _size(possible: Possible) -> tuple[float, float]:
    """Size and standard error in the effect's unit, from the model that has it last."""
    fit = possible.after.fit
    effect, last = possible.effect, len(fit.effects) - 1
    coefficients = fit.coefficients(last)
    size = effect.size(coefficients, fit.values, fit.at)
    columns = np.searchsorted(fit.space.identified, fit.model.columns[last])
    noise = fit.rss / max(fit.freedoms, 1)
    spread = noise * fit.covariance[np.ix_(columns, columns)]
    step = _STEP * np.sqrt(np.maximum(np.diag(spread), 1e-300))
    slope: Array = np.array(
        [
            (
                effect.size(coefficients + step * unit, fit.values, fit.at)
                - effect.size(coefficients - step * unit, fit.values, fit.at)
            )
            / (2.0 * s)
            for s, unit in zip(step, np.eye(len(step)), strict=True)
        ]
    )
    error = np.sqrt(max(float(slope @ spread @ slope), 0.0)) if len(slope) else 0.0
    return size / effect.to_si, float(error) / effect.to_si
