"""How much each candidate would explain: score statistics after projection, and their evidence.

The residual r of a fit is compared with the part G of each trace that the present parameters
cannot absorb (Rao's score test): S = r' G (G'G)^+ G' r. Noise enters by the residual itself,
F = (S / k) / ((|r|^2 - S) / (m - k)) on m degrees of freedom, so that an assumed noise that is
too small or too large does not name anything.

Rivals are ranked by evidence: the marginal likelihood with each coefficient normal about zero,
its standard deviation a mixture of scales about the plausible size. The forms of one
candidate share its evidence, so that a search over moments or harmonics pays for itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaln

from solver.effects.effect import Effect
from solver.gap.candidates import Candidate
from solver.gap.fit import Fit
from solver.gap.trace import codes, traces

Array = NDArray[np.float64]

_LEAST_NOISE = 1e-9  # of the assumed variance: few poses can be fitted without any misfit
_NOTHING = 1e-2  # noise units: what leaves less at its plausible size leaves nothing
_RETAINED = 1e-5  # of a trace's squared length: less is rounding
_SCALES = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0])  # of the plausible size
_WEIGHTS = np.array([0.05, 0.1, 0.2, 0.3, 0.2, 0.1, 0.05])


@dataclass(frozen=True)
class Form:
    """One variant of a candidate, in noise units.

    Attributes:
        effect: the variant.
        candidate: index of its candidate.
        basis: (M, q) orthonormal basis of its trace after projection, q <= k.
        trace: (M, k) the trace after projection, per unit coefficient [1/SI].
        retained: kappa, the fraction of the trace's squared length that projection left.
        whole: whether the trace is one column, all of an effect that has no small form.
    """

    effect: Effect
    candidate: int
    basis: Array
    trace: Array
    retained: float
    whole: bool


@dataclass(frozen=True)
class Scores:
    """The forms of all candidates against one residual.

    Attributes:
        forms: V of them.
        statistic: (V,) S.
        log_p: (V,) log of the F test's p-value, each form by itself.
        log_evidence: (V,) log marginal likelihood ratio against the present model.
        freedoms: m of the residual.
    """

    forms: tuple[Form, ...]
    statistic: Array
    log_p: Array
    log_evidence: Array
    freedoms: int


def forms(fit: Fit, tested: Sequence[Candidate]) -> tuple[Form, ...]:
    """Traces of all variants of ``tested``, projected off what the parameters of ``fit`` absorb."""
    flat = [(i, variant) for i, c in enumerate(tested) for variant in c.variants]
    found = traces(fit, [variant for _, variant in flat])
    if not found:
        return ()
    widths = [t.shape[1] for t in found]
    whole = np.concatenate(found, axis=1)
    rest = fit.projected(whole)
    ends = np.cumsum(widths)[:-1]
    return tuple(
        _form(variant, i, full, projected, codes(fit, variant))
        for (i, variant), full, projected in zip(
            flat, np.split(whole, ends, axis=1), np.split(rest, ends, axis=1), strict=True
        )
    )


def _form(effect: Effect, candidate: int, full: Array, projected: Array, whole: bool) -> Form:
    scale = np.linalg.norm(full, axis=0)
    plausible = np.array([1.0] if whole else [c.plausible for c in effect.coefficients])
    # A column that is nothing is rounding, which may well look like the residual that it is rounded with.
    some = scale * plausible >= _NOTHING
    if not some.any():
        return Form(effect, candidate, projected[:, :0], projected, 0.0, whole)
    seen, scale = projected[:, some], scale[some]
    length = np.linalg.norm(seen, axis=0)
    retained = float(np.mean((length / scale) ** 2))
    if len(scale) == 1:  # most forms are, and there are many
        basis = seen / length if retained > _RETAINED else seen[:, :0]
    else:
        left, singular, _ = np.linalg.svd(seen / scale, full_matrices=False)
        basis = left[:, singular**2 > _RETAINED]
    return Form(effect, candidate, basis, projected, retained, whole)


def scores(fit: Fit, tested: Sequence[Form]) -> Scores:
    """All forms against the residual of ``fit``."""
    r = fit.projected(fit.stacked[:, None])[:, 0]
    total, m = float(r @ r), fit.freedoms
    statistic = np.array([float(np.sum((form.basis.T @ r) ** 2)) for form in tested])
    width = np.array([form.basis.shape[1] for form in tested])
    log_p = log_f_tail(statistic, width, total, m)
    best = float(statistic.max(initial=0.0))
    noise = max((total - best) / max(m - 1, 1), _LEAST_NOISE)
    evidence = np.array([_log_evidence(form, r, noise) for form in tested])
    return Scores(tuple(tested), statistic, log_p, evidence, m)


def log_f_tail(statistic: Array, width: Array, total: Array | float, freedoms: int) -> Array:
    """Log p of S out of a total sum of squares on m degrees of freedom, k = ``width``; no underflow.

    p = I_x((m - k)/2, k/2), the regularised incomplete beta function, at x = 1 - S / total.
    """
    x = np.clip(1.0 - statistic / total, 1e-300, 1.0)
    a, b = np.maximum(0.5 * (freedoms - width), 0.5), 0.5 * width
    x, a, b = np.broadcast_arrays(x, a, b)
    usable = b > 0
    safe_b = np.where(usable, b, 1.0)
    p = betainc(a, safe_b, x)
    # Far in the tail: the first terms of the series in x.
    series = 1.0 + (1.0 - safe_b) * a * x / (a + 1.0) + 0.0
    tail = a * np.log(x) - np.log(a) - betaln(a, safe_b) + np.log(np.maximum(series, 1e-12))
    out = np.where(p > 1e-290, np.log(np.maximum(p, 1e-300)), tail)
    return np.asarray(np.where(usable, out, 0.0))


def _log_evidence(form: Form, r: Array, noise: float) -> float:
    """Log of the marginal likelihood over that without the effect, at noise variance ``noise``."""
    if not form.basis.shape[1]:
        return 0.0
    if form.whole:
        # A coded effect has no size of its own: it is there or not.
        d = form.trace[:, 0]
        return float((r @ r - (r - d) @ (r - d)) / (2.0 * noise))
    plausible = np.array([c.plausible for c in form.effect.coefficients])
    scaled = form.trace * plausible / np.sqrt(noise)
    gram, pull = scaled.T @ scaled, scaled.T @ r / np.sqrt(noise)
    values, vectors = np.linalg.eigh(gram) if len(gram) > 1 else (gram[0], np.eye(1))
    values, pull = np.maximum(values, 0.0), vectors.T @ pull
    variance = _SCALES[:, None] ** 2
    each = np.sum(
        0.5 * pull**2 * variance / (1.0 + variance * values) - 0.5 * np.log1p(variance * values),
        axis=1,
    )
    return log_sum(each + np.log(_WEIGHTS))


def log_sum(terms: Array) -> float:
    """Log of the sum of the exponentials of ``terms``."""
    top = float(np.max(terms))
    return top + float(np.log(np.sum(np.exp(terms - top))))
