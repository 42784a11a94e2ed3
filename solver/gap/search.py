"""The search for what is missing: add, refit, drop what became needless, swap for every rival.

An effect is a possible name when the model that it grows leaves nothing significant behind.
One possible name is a name; several are a group that this data cannot tell apart. Where no
single effect is enough, the best goes in and the search goes on, up to four; then each is
swapped for every rival in turn. What still stands out after that is none of the known effects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.effects.effect import Effect, Recorded
from solver.gap.candidates import Candidate, Untestable, candidates
from solver.gap.fit import Fit, extended, without
from solver.gap.score import Form, forms, scores
from solver.gap.screen import Screen, Threshold, screen, threshold

MOST = 4
"""Effects that one analysis names at most."""

LEVEL = 0.03
"""How often nothing at all may look like something."""

MORE = 0.01
"""The same for something beside what is named already: a second name needs more evidence."""

_REAL = 0.3  # of what the linear model promises, at the least
_UNLIKELY = 7.0  # of log evidence: a rival a thousand times less likely is none,
_AS_GOOD = 4.0  # unless it fits as well: noise units of chi-square by which it may explain less
_NEVER = 100.0  # times the plausible size
_RIVALS = 8  # candidates that are refitted in full, at most
_MARGIN = 30.0  # noise units of chi-square by which a rival may explain less and still be refitted
_SHARE = 0.02  # or this share of the best
_SHAPE = 0.03  # of a named effect's chi-square: less, at the same place, is its shape, not another effect
_FORM = 0.015  # of the best explanation: by so much the right effect may miss it
_IMPOSSIBLE = 3.0  # standard errors beyond a physical bound


@dataclass(frozen=True)
class Look:
    """One fit with every candidate held against its residual."""

    fit: Fit
    candidates: tuple[Candidate, ...]
    untestable: tuple[Untestable, ...]
    forms: tuple[Form, ...]
    screen: Screen

    def significant(self, level: float) -> bool:
        """Whether anything stands out."""
        return self.screen.p <= level

    def form(self, candidate: int) -> Form:
        """Its most significant form."""
        form: Form = self.forms[self.screen.best_form[candidate]]
        return form

    def statistic(self, candidate: int) -> float:
        """Its score statistic, in units of the assumed noise."""
        return float(self.screen.scores.statistic[self.screen.best_form[candidate]])


@dataclass(frozen=True)
class Possible:
    """A candidate that was added, and what it left.

    Attributes:
        effect: in the form that fits best.
        after: the model with it.
        log_evidence: against the model without.
        explained: chi-square that it took away, in units of the noise that is left.
        retained: kappa of its trace.
        enough: whether nothing significant is left.
    """

    effect: Effect
    after: Look
    log_evidence: float
    explained: float
    retained: float
    enough: bool


@dataclass(frozen=True)
class Named:
    """One effect of the answer, with all effects that could stand in its place, best first."""

    best: Possible
    rivals: tuple[Possible, ...]


@dataclass(frozen=True)
class Search:
    """What a search found.

    Attributes:
        before: the model as it was.
        after: the model with all named effects; the same where nothing was found.
        named: the effects.
        complete: whether nothing significant is left.
    """

    before: Look
    after: Look
    named: tuple[Named, ...]
    complete: bool


Pool = tuple[tuple[Candidate, ...], tuple[Untestable, ...]]
"""All candidates, and those that cannot be tested."""

Progress = Callable[[str], None]


def look(
    fit: Fit,
    rng: np.random.Generator,
    limits: Threshold | None = None,
    pool: Pool | None = None,
) -> Look:
    """``fit`` with every candidate held against its residual.

    Args:
        fit: the model.
        rng: for the draws.
        limits: what noise does, from a model much like this one; drawn anew by default.
        pool: the candidates of such a model, their forms found already; sought anew by default.
    """
    tested, hopeless = candidates(fit) if pool is None else pool
    taken = {effect.label for effect in fit.effects}
    tested = tuple(c for c in tested if c.label not in taken)
    labels = [c.label for c in tested]
    found = forms(fit, tested)
    limits = threshold(fit, found, labels, rng) if limits is None else limits
    return Look(fit, tested, hopeless, found, screen(fit, found, labels, limits))


def search(
    fit: Fit,
    rng: np.random.Generator,
    progress: Progress = lambda text: None,
    *,
    level: float = LEVEL,
) -> Search:
    """Look for effects that are missing from ``fit``.

    Args:
        fit: the model as it is.
        rng: for the draws.
        progress: is told what is being tried.
        level: how often nothing at all may look like something.
    """
    progress("screening")
    pool = candidates(fit)
    trial = _Trial(rng, progress, pool)
    before = now = look(fit, rng, pool=pool)
    chosen: list[Possible] = []
    first: list[Possible] = []
    while (
        now.significant(MORE if chosen else level)
        and len(chosen) < MOST
        and not _shape_only(now, chosen)
    ):
        found = trial.possible(now, MORE if chosen else level)
        if not found:
            break
        first = first or found
        best = next((p for p in found if p.enough), found[0])
        if _more_behind(found[0]):
            best = found[0]
        chosen.append(best)
        now = best.after
    if not chosen:
        return Search(before, before, (), not before.significant(level))
    complete = not now.significant(MORE) or _shape_only(now, chosen)
    if len(chosen) == 1:
        alone = grouped(chosen[0], first)
        return Search(before, alone.best.after, (alone,), complete)
    named: list[Named] = []
    for mine in [p.effect.label for p in chosen]:
        labels = [effect.label for effect in now.fit.effects]
        if mine not in labels:
            continue
        reduced = without(now.fit, labels.index(mine))
        if reduced is None:
            continue
        around = look(reduced, rng, pool=pool)
        if not around.significant(MORE):
            now = around  # the others have made it needless
            continue
        rivals = trial.possible(around, MORE)
        own = next((p for p in rivals if p.effect.label == mine), None)
        first_choice = next(p for p in chosen if p.effect.label == mine)
        named.append(grouped(own or first_choice, rivals))
    return Search(before, now, tuple(named), complete)


def grouped(best: Possible, tried: Sequence[Possible]) -> Named:
    """``best`` with those of ``tried``, best evidence first, that nothing speaks against beside it.

    Whether something stands out behind a candidate is decided by chance where that is just so. One
    that is likelier than another which leaves nothing, or fits as well, may not be dropped for it.
    """
    enough = [p for p in tried if p.enough]
    if not enough:
        return Named(best, ())
    likeliest = max(p.log_evidence for p in enough)
    explained = max(p.explained for p in enough)
    rivals = [
        p
        for p in tried
        if p.enough or p.log_evidence > likeliest or p.explained > explained - _AS_GOOD
    ]
    first = rivals[0]
    return Named(
        first,
        tuple(
            p
            for p in rivals[1:]
            if p.log_evidence > first.log_evidence - _UNLIKELY
            or p.explained > first.explained - _AS_GOOD
        ),
    )


@dataclass(frozen=True)
class _Trial:
    """How candidates are tried: the draws, who is told, and the pool."""

    rng: np.random.Generator
    progress: Progress
    pool: Pool

    def possible(self, now: Look, level: float) -> list[Possible]:
        """The candidates that come into question at ``level``, each added and refitted, best evidence first."""
        statistics = np.array([now.statistic(i) for i in range(len(now.candidates))])
        if not len(statistics):
            return []
        noise = now.fit.rss / max(now.fit.freedoms, 1)
        best = float(statistics.max())
        left = max(now.fit.rss - best, 0.0) / max(now.fit.freedoms, 1)
        near = statistics >= best - max(_MARGIN * min(noise, max(left, 1e-12)), _SHARE * best)
        order = [i for i in np.argsort(-now.screen.log_evidence) if near[i] and statistics[i] > 0]
        stands_out = now.screen.significant(level)
        out: list[Possible] = []
        standing: list[float] = []
        most, limits = 0.0, None
        for i in order[:_RIVALS]:
            self.progress(f"trying {now.candidates[i].label}")
            fit = _refitted(now, int(i))
            if fit is None or fit.rss > now.fit.rss:
                continue
            explained = (now.fit.rss - fit.rss) / _noise_of(now)
            if explained < _REAL * now.statistic(int(i)) / _noise_of(now):
                continue  # what the linear model promised was curvature, not explanation
            if explained < min(most - _MARGIN, (1.0 - _SHARE) * most):
                continue  # the best one would stand out behind it
            added = self._added(now, int(i), fit, explained, limits)
            limits = added.after.screen.threshold if limits is None and added.enough else limits
            most = max(most, explained)
            out.append(added)
            if stands_out[i]:
                standing.append(explained)
        # What does not stand out itself may only stand in for what does, and as well as that.
        least = max(standing, default=np.inf) - _AS_GOOD
        labels = {now.candidates[i].label for i in order if stands_out[i]}
        out = [p for p in out if p.effect.label in labels or p.explained > least]
        # No effect has exactly the form that a model gives it: a small share of the best fit is forgiven.
        forgiven = (0.5 * min(most - p.explained, _FORM * most) for p in out)
        fair = [
            replace(p, log_evidence=p.log_evidence + more)
            for p, more in zip(out, forgiven, strict=True)
        ]
        return sorted(fair, key=lambda p: -p.log_evidence)

    def _added(
        self, now: Look, candidate: int, fit: Fit, explained: float, limits: Threshold | None
    ) -> Possible:
        form, after = now.form(candidate), look(fit, self.rng, limits, self.pool)
        linear = float(now.screen.scores.log_evidence[now.screen.best_form[candidate]])
        spread = float(now.screen.log_evidence[candidate]) - linear
        # The evidence of the linear model, with the misfit that the full refit reached in its place.
        gain = 0.5 * (explained - now.statistic(candidate) / _noise_of(now))
        return Possible(
            fit.effects[-1],
            after,
            linear + spread + gain,
            explained,
            form.retained,
            not after.significant(MORE) or _only_shape(after, explained),
        )


def _refitted(now: Look, candidate: int) -> Fit | None:
    """The fit of ``now`` with one candidate more; None where there is none that could be."""
    form = _closer(now, now.form(candidate))
    if not form.basis.shape[1]:
        return None
    shape = form.effect.coefficients
    start = np.array([c.start for c in shape])
    if not form.whole:
        start = start + np.linalg.lstsq(form.trace, now.fit.stacked, rcond=1e-6)[0]
    bounds = np.array([[c.low, c.high] for c in shape]).reshape(len(shape), 2)
    fit = extended(now.fit, form.effect, np.clip(start, bounds[:, 0], bounds[:, 1]))
    if fit is None or _unphysical(fit) or _implausible(fit):
        return None
    return fit


def _closer(now: Look, form: Form) -> Form:
    """``form``, or the best of those much like it where the screen tried but some of many."""
    fit = now.fit
    more = form.effect.closer(Recorded(fit.values, fit.at, fit.observed.counts))
    if not more:
        return form
    mine = Candidate(form.effect.name, form.effect.where, more)
    near = forms(fit, [mine])
    return near[int(np.argmax(scores(fit, near).log_evidence))]


def _noise_of(now: Look) -> float:
    best = float(now.screen.scores.statistic.max(initial=0.0))
    return float(max((now.fit.rss - best) / max(now.fit.freedoms - 1, 1), 1e-300))


def _unphysical(fit: Fit) -> bool:
    """Whether the last effect came out beyond its physical bounds, by more than noise explains."""
    number = len(fit.effects) - 1
    scale = np.sqrt(max(fit.rss / max(fit.freedoms, 1), 1e-300))
    values, errors = fit.coefficients(number), fit.standard_errors(number, scale)
    for c, value, error in zip(fit.effects[number].coefficients, values, errors, strict=True):
        if not c.low - _IMPOSSIBLE * error <= value <= c.high + _IMPOSSIBLE * error:
            return True
    return False


def _implausible(fit: Fit) -> bool:
    """Whether the last effect would have to be far larger than is ever met."""
    number = len(fit.effects) - 1
    plausible = np.array([c.plausible for c in fit.effects[number].coefficients])
    beyond = fit.coefficients(number) - np.array(
        [c.start for c in fit.effects[number].coefficients]
    )
    return bool(len(plausible) and np.max(np.abs(beyond) / plausible) > _NEVER)


def _more_behind(first: Possible) -> bool:
    """Whether something surely follows behind a candidate: then another that seems enough was taken for both."""
    likely = float(first.after.screen.log_evidence.max(initial=0.0))
    return not first.enough and likely > _UNLIKELY


def _shape_only(now: Look, chosen: Sequence[Possible]) -> bool:
    """Whether what stands out is but the shape of effects that are named already.

    A strong effect is never exactly of the form that a model gives it; what is left then stands
    out at the same place, far smaller.
    """
    return bool(chosen) and _only_shape(now, max(p.explained for p in chosen))


def _only_shape(now: Look, largest: float) -> bool:
    standing_out = now.screen.significant(MORE)
    standing = [i for i in range(len(now.candidates)) if standing_out[i]]
    if not standing:
        return False
    left = now.fit.rss / max(now.fit.freedoms, 1)
    return all(now.statistic(i) / left < _SHAPE * largest for i in standing)
