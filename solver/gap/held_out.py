"""The gap on poses that took no part: before and after what was found is added, floor 1.

G^2 is the mean, over held-out poses, of r' (Sigma + J Cov J')^-1 r over its dimension, with
Sigma the noise and Cov that of the parameters: 1 where model and noise explain everything. Poses
are held out whole, with all their visits, a fifth at a time; what is missing is looked for anew
in the rest, so that the choice itself is tested.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.effects.effect import Effect
from solver.estimate.nuisance import settle
from solver.gap.candidates import candidates
from solver.gap.fit import Fit, extended, refit
from solver.gap.screen import Threshold
from solver.gap.search import look

Array = NDArray[np.float64]

FOLDS = 5
_FEWEST = 10  # poses of which a fifth can be held out
_SIGNIFICANT = 2.0  # standard errors
_ABOVE = 3.0  # standard errors by which what is left exceeds the floor


@dataclass(frozen=True)
class HeldOut:
    """The gap on P held-out poses.

    Attributes:
        poses: how many.
        before: G of the model as it was.
        after: G with the effects.
        before_error, after_error: their standard errors.
        closed: share of the gap that is closed, (G0^2 - G1^2) / (G0^2 - 1); None where G0 does
            not exceed 1 significantly.
        each_before, each_after: (P,) G^2 of each dwell, in the order of the recording.
    """

    poses: int
    before: float
    after: float
    before_error: float
    after_error: float
    closed: float | None
    each_before: Array
    each_after: Array

    @property
    def above_floor(self) -> float:
        """By how many standard errors what is left exceeds the floor."""
        return (self.after**2 - 1.0) / max(2.0 * self.after * self.after_error, 1e-300)

    @property
    def opens(self) -> bool:
        """Whether the model as it was leaves a significant gap."""
        return self.before - 1.0 > _SIGNIFICANT * self.before_error

    @property
    def left_open(self) -> bool:
        """Whether what was found leaves so much that it cannot be the same in all parts of the poses."""
        return self.above_floor > _ABOVE


def held_out(
    fit: Fit,
    known: Fit,
    named: Sequence[Effect],
    poses: NDArray[np.intp],
    variance: float,
    rng: np.random.Generator,
    limits: Threshold,
    progress: Callable[[float], None] = lambda share: None,
) -> HeldOut | None:
    """The gap of ``fit`` with and without what was found missing.

    Args:
        fit: the model as it was.
        known: the same with what raw codes show, whatever the poses.
        named: effects that were named; as many are looked for again in each part of the poses.
        poses: (P,) which pose each dwell visited.
        variance: of the noise, in units of the assumed one.
        rng: deals the poses out.
        limits: what noise does to the candidates.
        progress: is told the share done.

    Returns:
        The gap, or None where the poses are too few.
    """
    distinct = np.unique(poses)
    if len(distinct) < _FEWEST:
        return None
    fold = rng.permutation(np.arange(len(distinct)) % FOLDS)[np.searchsorted(distinct, poses)]
    before, after = np.full(len(poses), np.nan), np.full(len(poses), np.nan)
    for k in range(FOLDS):
        tested, trained = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        progress(k / FOLDS)
        base = _trained(fit, trained)
        sound = base if known is fit else _trained(known, trained)
        if base is None or sound is None:
            continue
        grown = _grown(sound, named, rng, limits)
        before[tested] = _squares(base, fit, tested, variance)
        after[tested] = _squares(grown, known, tested, variance)
    used = ~(np.isnan(before) | np.isnan(after))
    if not used.any():
        return None
    square = [float(g[used].mean()) for g in (before, after)]
    error = [float(g[used].std(ddof=1) / np.sqrt(used.sum())) for g in (before, after)]
    root = np.sqrt(square)
    significant = square[0] - 1.0 > _SIGNIFICANT * error[0]
    return HeldOut(
        int(used.sum()),
        float(root[0]),
        float(root[1]),
        error[0] / (2.0 * float(root[0])),
        error[1] / (2.0 * float(root[1])),
        (square[0] - square[1]) / (square[0] - 1.0) if significant else None,
        before,
        after,
    )


def _trained(fit: Fit, poses: NDArray[np.intp]) -> Fit | None:
    """``fit`` of some of its poses."""
    return refit(
        fit.model.site,
        fit.effects,
        fit.observed.take(poses),
        fit.parameters,
        fit.settled.coordinates[poses],
        priors=fit.priors,
    )


def _grown(base: Fit, named: Sequence[Effect], rng: np.random.Generator, limits: Threshold) -> Fit:
    """``base`` with as many effects as ``named``, chosen anew by its own poses.

    Where the choice falls on an effect that was named, its settings are those that were found in
    all poses: a moment between two held-out dwells cannot be found without them.
    """
    now, pool = base, candidates(base) if named else ((), ())
    settings = {effect.label: effect for effect in named}
    for _ in named:
        seen = look(now, rng, limits, pool)
        evidence = seen.screen.log_evidence
        if not len(evidence) or not np.isfinite(evidence).any():
            break
        form = seen.form(int(np.argmax(evidence)))
        effect = settings.get(form.effect.label, form.effect)
        start = np.array([c.start for c in effect.coefficients])
        if not form.whole and effect is form.effect:
            start = start + np.linalg.lstsq(form.trace, now.stacked, rcond=1e-6)[0]
        more = extended(now, effect, start)
        if more is None:
            break
        now = more
    return now


def _squares(trained: Fit, whole: Fit, tested: NDArray[np.intp], variance: float) -> Array:
    """G^2 of each of the dwells ``tested`` (T,) of ``whole``, by the parameters of ``trained``."""
    observed = whole.observed.take(tested)
    found = settle(
        trained.model,
        observed,
        whole.settled.coordinates[tested],
        trained.parameters,
        trained.space.expansion,
    )
    d = trained.redundancy
    out = np.full(len(tested), np.nan)
    for i in np.flatnonzero(found.closed):
        J, r = found.jacobian[i], found.residual[i]
        # The residual lies where readings are redundant: the d directions that coordinates cannot reach.
        basis = _redundant(trained, whole, int(tested[i]), d)
        z, by = basis.T @ r, basis.T @ J
        spread = variance * (np.eye(basis.shape[1]) + by @ trained.covariance @ by.T)
        out[i] = float(z @ np.linalg.solve(spread, z)) / max(basis.shape[1], 1)
    return out


def _redundant(trained: Fit, whole: Fit, pose: int, dimension: int) -> Array:
    """(C, d) orthonormal directions of whitened readings in which a residual can lie."""
    rows = np.array([pose])
    observed = whole.observed.take(rows)
    at = trained.model.linearise(
        whole.settled.coordinates[rows],
        trained.parameters,
        np.zeros((len(trained.parameters), 0)),
        observed.at,
    )
    H = at.readings_by_coordinates[0] / observed.sigma[0][:, None]
    A = at.closure_by_coordinates[0]
    if len(A):
        _, singular, right = np.linalg.svd(A)
        rank = int(np.sum(singular > 1e-9 * singular[:1].sum()))
        H = H @ right[rank:].T
    left = np.linalg.svd(H, full_matrices=True)[0]
    return np.asarray(left[:, left.shape[1] - dimension :])
