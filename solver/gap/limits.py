"""Detection limits: the smallest size of each effect that a recording would have shown.

An effect of strength lambda (the squared length of its trace after projection, in noise units)
makes F noncentral. The limit is the size at which nine of ten such recordings would pass the
screen's critical value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri, ndtri

from solver.effects.effect import Array, Coefficient
from solver.gap.result import Limit
from solver.gap.search import LEVEL, Look

_POWER = 0.9


def limits(look: Look) -> tuple[Limit, ...]:
    """Of every candidate of ``look``, in catalogue order; coded effects have their own sizes."""
    fit = look.fit
    noise = fit.rss / max(fit.freedoms, 1)
    critical = look.screen.threshold.critical(LEVEL)
    out = []
    for i, candidate in enumerate(look.candidates):
        mine = [form for form in look.forms if form.candidate == i and not form.whole]
        if not mine:
            continue
        form = mine[int(np.argmax([f.retained for f in mine]))]
        k = form.basis.shape[1]
        if not k:
            continue
        worth = look.screen.threshold.forms_worth.get(candidate.label, 1.0)
        reach = float(chdtri(k, min(np.exp(critical) / worth, 0.5)))
        # Noncentral chi-square is near normal about k + lambda with variance 2 (k + 2 lambda).
        z = float(ndtri(_POWER))
        strength = reach
        for _ in range(50):
            strength = reach - k + z * np.sqrt(2.0 * (k + 2.0 * max(strength, 0.0)))
        direction = _typical(form.trace, form.effect.coefficients, k)
        length = float(np.linalg.norm(form.trace @ direction)) / np.sqrt(noise)
        if length <= 0:
            continue
        start = np.array([c.start for c in form.effect.coefficients])
        coefficients = start + direction * np.sqrt(max(strength, 0.0)) / length
        size = form.effect.size(coefficients, fit.values, fit.at)
        out.append(
            Limit(
                candidate.name,
                candidate.where,
                abs(size) / form.effect.to_si,
                form.effect.unit,
            )
        )
    return tuple(out)


def _typical(trace: Array, coefficients: Sequence[Coefficient], width: int) -> Array:
    """The direction in plausible units along which the trace is of middling length, of the ``width`` longest."""
    plausible = np.array([c.plausible for c in coefficients])
    _, _, right = np.linalg.svd(trace * plausible, full_matrices=False)
    return np.asarray(plausible * right[width // 2])
