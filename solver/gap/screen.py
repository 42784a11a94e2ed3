"""Which candidates stand out from noise, among as many as are tried.

The critical value comes from the residual itself: each dwell's residual keeps its size and
loses its sign at random (a wild bootstrap by visits, after Wu 1986), which is what no effect at
all would look like whatever the noise's distribution, and the most significant candidate of
each such draw is noted. A candidate with many forms (moments, harmonics) pays for them by the
same draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.gap.fit import Fit
from solver.gap.score import Form, Scores, log_f_tail, log_sum, scores

Array = NDArray[np.float64]

DRAWS = 400


@dataclass(frozen=True)
class Threshold:
    """What noise alone does to a set of candidates.

    Attributes:
        forms_worth: by the candidates' labels, how many independent forms their forms are worth.
        lowest: (DRAWS,) sorted lowest log p of all candidates under noise.
    """

    forms_worth: Mapping[str, float]
    lowest: Array

    def critical(self, level: float) -> float:
        """Log p (of a candidate, its forms paid for) that noise reaches in ``level`` of cases."""
        return float(np.quantile(self.lowest, level))


@dataclass(frozen=True)
class Screen:
    """N candidates against one residual.

    Attributes:
        scores: of all forms.
        best_form: (N,) index of each candidate's form of greatest evidence.
        log_p: (N,) of each candidate, its forms paid for.
        log_evidence: (N,) of each candidate, its forms sharing it (`_believed`).
        threshold: what noise alone reaches.
    """

    scores: Scores
    best_form: NDArray[np.intp]
    log_p: Array
    log_evidence: Array
    threshold: Threshold

    def significant(self, level: float) -> NDArray[np.bool_]:
        """(N,) which candidates stand out at a family-wise level."""
        return self.log_p < self.threshold.critical(level)

    @property
    def p(self) -> float:
        """Family-wise p-value of the most significant candidate; no finer than the draws."""
        lowest = float(self.log_p.min(initial=0.0))
        below = int(np.searchsorted(self.threshold.lowest, lowest, side="right"))
        return (below + 1) / (len(self.threshold.lowest) + 1)


def threshold(
    fit: Fit, tested: Sequence[Form], labels: Sequence[str], rng: np.random.Generator
) -> Threshold:
    """What noise alone makes of ``tested``, the forms of candidates called ``labels``."""
    count = len(labels)
    if not tested:
        return Threshold(dict.fromkeys(labels, 1.0), np.zeros(DRAWS))
    drawn = fit.drawn(DRAWS, rng)
    total = np.sum(drawn**2, axis=0)
    widths = np.array([form.basis.shape[1] for form in tested])
    projected = np.concatenate([form.basis for form in tested], axis=1).T @ drawn
    starts = np.concatenate([[0], np.cumsum(widths)[:-1]])
    statistic = np.zeros((len(tested), DRAWS))
    some = widths > 0
    statistic[some] = np.add.reduceat(projected**2, starts[some], axis=0)
    log_p = log_f_tail(statistic, widths[:, None], total, fit.freedoms)
    owner = np.array([form.candidate for form in tested])
    lowest = np.zeros((count, DRAWS))
    np.minimum.at(lowest, owner, log_p)
    # A candidate whose forms are worth w independent ones has lowest p with median 1 - 0.5^(1/w).
    median = np.clip(np.exp(np.median(lowest, axis=1)), 1e-12, 1.0 - 1e-12)
    several = np.bincount(owner, minlength=count) > 1
    worth = np.where(several, np.maximum(np.log(0.5) / np.log1p(-median), 1.0), 1.0)
    paid = np.sort(_paid(lowest, worth[:, None]).min(axis=0))
    return Threshold(dict(zip(labels, worth.tolist(), strict=True)), paid)


def _believed(mine: Sequence[Form]) -> Array:
    """(V,) log of the share that each form of one candidate has of its evidence, before anything was seen.

    Forms of as many coefficients share alike, and so does each number of coefficients: that there are
    several straight lines that bend does not make a bent one likelier than a straight one.
    """
    sizes = np.array([len(form.effect.coefficients) for form in mine])
    alike = (sizes[:, None] == sizes).sum(axis=1)
    return np.asarray(-np.log(alike * len(np.unique(sizes))))


def _paid(log_p: Array, worth: Array) -> Array:
    """Log of 1 - (1 - p)^w, which is w p far in the tail."""
    p = np.exp(np.maximum(log_p, -700.0))
    exact = np.log(np.maximum(-np.expm1(worth * np.log1p(-np.minimum(p, 1.0 - 1e-16))), 1e-300))
    return np.asarray(np.where(log_p < -20.0, log_p + np.log(worth), exact))


def screen(fit: Fit, tested: Sequence[Form], labels: Sequence[str], limits: Threshold) -> Screen:
    """The candidates called ``labels`` against the residual of ``fit``."""
    found = scores(fit, tested)
    count = len(labels)
    owner = np.array([form.candidate for form in tested], dtype=np.intp)
    best = np.zeros(count, dtype=np.intp)
    log_p, evidence = np.zeros(count), np.full(count, -np.inf)
    for i in range(count):
        mine = np.flatnonzero(owner == i)
        if len(mine):
            each = found.log_evidence[mine] + _believed([tested[form] for form in mine.tolist()])
            best[i] = mine[int(np.argmax(each))]
            log_p[i] = found.log_p[mine].min()
            evidence[i] = log_sum(each)
    worth = np.array([limits.forms_worth.get(label, 1.0) for label in labels])
    return Screen(found, best, _paid(log_p, worth), evidence, limits)
