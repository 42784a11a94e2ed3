"""The rig that a gap analysis grows: its text with what was found missing, everything else kept."""

from __future__ import annotations

import numpy as np

from loopcal.console import fail
from recordings.rig.edit import Calibrated, with_effect, with_values
from solver.gap.result import Gap, MissingEffect, Verdict
from solver.report.gap_words import called, in_full, odds, sized

_REFUSED = {
    Verdict.NOTHING: "nothing detectable is missing from the rig, so there is no effect to write into it",
    Verdict.UNKNOWN: "what is missing is none of the known effects, so there is no effect to write into the rig",
}


def grown_rig(text: str, gap: Gap) -> str:
    """The rig file ``text`` with the effects of ``gap`` and every identified value at its estimate.

    Comments and layout stay, so that a comparison with ``text`` shows what the analysis changed.
    Refuses an analysis that names nothing.
    """
    if not gap.effects:
        fail(f"{_REFUSED[gap.verdict]}; no rig was written")
    fit = gap.after
    scale = float(np.sqrt(fit.rss / max(fit.freedoms, 1)))
    errors = scale * np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    known = len(gap.before.effects)
    added = {
        int(column) for columns in fit.model.columns[known:] for column in np.atleast_1d(columns)
    }
    values = {}
    for index, error in zip(fit.space.identified, errors, strict=True):
        if int(index) not in added:
            p = fit.space.table[index]
            values[p.name] = Calibrated(float(fit.parameters[index]), float(error), p.dimension)
    out = with_values(text, values)
    told = {f"{effect.name}@{effect.where}": effect for effect in gap.effects}
    for number in range(known, len(fit.effects)):
        effect = fit.effects[number]
        entry = effect.entry(
            fit.coefficients(number).tolist(), fit.standard_errors(number, scale).tolist()
        )
        out = with_effect(out, entry, _remarks(told.get(effect.label), gap.provisional))
    return out


def _remarks(effect: MissingEffect | None, provisional: bool) -> list[str]:
    if effect is None:
        return ["found missing by loopcal gap"]
    out = [f"found missing by loopcal gap: {called(effect.name, effect.where)}, {in_full(effect)}"]
    if provisional:
        out.append("provisional: no pose was visited again")
    out += [
        f"could also be: {called(rival.name, rival.where)}, {sized(rival)} ({odds(rival.log_evidence)})"
        for rival in effect.could_also_be
    ]
    return out
