"""What to capture next: the few poses that best tell the rivals apart that are left.

Feasible poses are those that `loopcal plan` may choose from. Of them those are taken, by greedy
choice and exchange, that maximise the smallest separation of any rival from any other (the
T-criterion, `separation`), given what was captured already, whatever form a rival may take then;
where more than three are left, those that minimise the probability of a wrong choice, weighed by the
evidence so far. Every pose is visited several times, in an order that reaches it from both sides
where that tells rivals apart.

Separation counts in units of what decides: the screen's critical value, or of a strong effect the
share of it that counts as its shape. Where not even a thousand poses would decide (one
effect contains the other, or both do the same), the pair takes no part and is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from recordings.rig import Plan
from solver.effects.effect import Array, Recorded
from solver.errors import MechanismError
from solver.gap.search import MORE, Possible, Search
from solver.gap.separation import Contest
from solver.gap.stops import VISITS, Merit, Reach, Visited, reaches
from solver.samples import PoseTable

POSES = 6
"""Poses that are proposed at most."""

_FEW = 3  # rivals up to which the worst pair counts
_EXCHANGES = 3  # rounds
_DRAWS = 40  # random choices that the proposed one is compared with
_UNENDING = 1000  # poses: what so many do not decide, poses do not decide
_FORMS = 3  # of a rival that count: the nearest by what was captured, and with more
_SOME_POSES = 18  # visits: about as many as are proposed
_SHAPE = 0.03  # of an effect's chi-square, as in `search`: less may be its exact shape


@dataclass(frozen=True)
class Pair:
    """One hypothesis, taken for true, against another; separations are lambda of `separation`.

    Attributes:
        effect, other: labels; ``other`` is "" for no effect at all.
        now: by what was captured.
        proposed: with the plan besides.
        random: with as many random poses of the same reach besides, the median.
        random_poses: how many random poses do as much as the plan; infinite where a thousand do not.
        separable: whether any number of poses would decide.
        chance: that ``other`` is ruled out after the plan, if ``effect`` is at work.
    """

    effect: str
    other: str
    now: float
    proposed: float
    random: float
    random_poses: float
    separable: bool
    chance: float

    @property
    def evidence(self) -> float:
        """Log evidence that the plan is expected to add."""
        return 0.5 * (self.proposed - self.now)


@dataclass(frozen=True)
class NextPoses:
    """A session that tells rivals apart.

    Attributes:
        plan: ready to be written to a plan file; None where no feasible poses tell any pair apart.
        coordinates: (N, U) the poses.
        coordinate_names: names of the U coordinates.
        pairs: every hypothesis against every other.
        chance: that the plan rules out whatever poses can rule out, whichever rival is at work
            (weighed by the evidence so far).
        contests: what was asked of the poses.
        reach: where they were looked for.
        visited: the session.
    """

    plan: Plan | None
    coordinates: Array
    coordinate_names: tuple[str, ...]
    pairs: tuple[Pair, ...]
    chance: float
    contests: tuple[Contest, ...]
    reach: Reach
    visited: Visited

    @property
    def twins(self) -> tuple[tuple[str, ...], ...]:
        """Groups of names that stay together whatever poses are captured, each name in one group at most."""
        groups: list[set[str]] = []
        for pair in self.pairs:
            if pair.separable or not pair.other:
                continue
            joined = {pair.effect, pair.other}
            for group in [g for g in groups if g & joined]:
                joined |= group
                groups.remove(group)
            groups.append(joined)
        order = [contest.effect.label for contest in self.contests]
        return tuple(tuple(sorted(group, key=order.index)) for group in groups)


@dataclass(frozen=True)
class _Question:
    """Hypotheses with their posterior weights (H,), and the chi-square beyond which a screen decides."""

    contests: tuple[Contest, ...]
    weights: Array
    critical: float

    def in_all_forms(self, reach: Reach) -> _Question:
        """Every rival in those forms, of all that these poses can tell apart, that come nearest to the others."""
        return replace(self, contests=tuple(_in_forms(c, reach) for c in self.contests))

    def captured(self) -> tuple[Array, ...]:
        return tuple(contest.captured() for contest in self.contests)

    def decisive(self, sums: Sequence[Array]) -> Array:
        """(..., pairs) lambda over what decides: above 1 a rival is more likely ruled out than not."""
        out = []
        for contest, own in zip(self.contests, sums, strict=True):
            shape = _SHAPE * contest.strength(own)[..., None]
            out.append(contest.separation(own) / np.maximum(self.critical, shape))
        return np.concatenate(out, axis=-1)

    def worth(self, separable: NDArray[np.bool_]) -> Merit:
        """What sums are worth, by the pairs that count."""
        pair_weights = self._pair_weights()[separable]

        def merit(sums: Sequence[Array]) -> Array:
            found = self.decisive(sums)[..., separable]
            if len(self.contests) <= _FEW:
                return np.asarray(found.min(axis=-1))
            # Bhattacharyya's bound on the probability of a wrong choice, exp(-lambda / 8) a pair.
            wrong = np.exp(-found * self.critical / 8.0) @ pair_weights
            return np.asarray(-np.log(wrong + 1e-300))

        return merit

    def _pair_weights(self) -> Array:
        """(pairs,) product of the two weights."""
        out = []
        for number, contest in enumerate(self.contests):
            others = np.delete(self.weights, number) if contest.others else np.ones(1)
            out.append(self.weights[number] * others)
        return np.concatenate(out)


def propose(
    found: Search, table: PoseTable, *, wanted: str | None = None, most: int = POSES
) -> NextPoses:
    """Poses that tell apart what a search could not.

    Args:
        found: the search.
        table: the poses that it saw.
        wanted: ``name@where`` of an effect that is to be seen if it is there, at a size such as is
            met in practice; else the rivals of what was named are told apart.
        most: how many poses at most.

    Raises:
        MechanismError: nothing is left to be told apart, ``wanted`` is no candidate, or nothing
            can be reached safely.
    """
    wished = _rivals(found) if wanted is None else _wanted(found, wanted)
    best: (
        tuple[tuple[int, float], _Question, Reach, list[int], NDArray[np.bool_], tuple[Array, ...]]
        | None
    )
    best = None
    for reach in reaches(found.after.fit, np.median(table.sigma[: len(table.sigma)], axis=0)):
        asked = wished.in_all_forms(reach)
        captured = asked.captured()
        sums = tuple(VISITS * s for s in reach.sums(asked.contests))
        separable = _separable(asked, captured, sums, reach)
        merit = asked.worth(separable)
        chosen = _chosen(captured, sums, merit, most) if separable.any() else [0]
        with_them = [g + s[chosen].sum(axis=0) for g, s in zip(captured, sums, strict=True)]
        value = float(merit(with_them)) if separable.any() else 0.0
        key = (int(separable.sum()), value)
        if best is None or key > best[0]:
            best = (key, asked, reach, chosen, separable, sums)
    assert best is not None  # reaches raises where there is none
    _, asked, reach, chosen, separable, sums = best
    captured = asked.captured()
    merit = asked.worth(separable) if separable.any() else lambda sums: np.zeros(())
    visited = reach.visited(chosen, asked.contests, captured, merit)
    pairs = _pairs(asked, captured, visited.sums, sums, separable, len(chosen))
    return NextPoses(
        visited.plan if separable.any() else None,
        reach.coordinates[chosen],
        found.after.fit.model.coordinate_names,
        pairs,
        _chance(asked, pairs),
        asked.contests,
        reach,
        visited,
    )


def _in_forms(contest: Contest, reach: Reach) -> Contest:
    """A rival may take another harmonic or moment than the one that fitted best, once more is captured."""
    fit = contest.fit
    recorded = Recorded(np.vstack([fit.values, reach.values()]), fit.at)
    every = []
    for (form,) in contest.others:
        forms = type(form).variants(fit.model.site, form.where, recorded)
        every.append((form, *forms) if len(forms) > 1 else (form,))
    if all(len(forms) <= _FORMS for forms in every):
        return replace(contest, others=tuple(every))
    whole = replace(contest, others=tuple(every))
    now = whole.captured()
    later = now + _SOME_POSES / len(reach.coordinates) * reach.summed(whole)
    return whole.nearest((now, later), _FORMS)


def _rivals(found: Search) -> _Question:
    """Every rival of the first effect that has any, against the others."""
    named = next((n for n in found.named if n.rivals), None)
    if named is None:
        raise MechanismError(
            "no rivals are left that more poses could tell apart; name an effect to look for"
        )
    every: tuple[Possible, ...] = (named.best, *named.rivals)
    evidence = np.array([p.log_evidence for p in every])
    weights = np.exp(evidence - evidence.max())
    contests = tuple(
        Contest(
            mine.effect,
            mine.after.fit.coefficients(len(mine.after.fit.effects) - 1),
            mine.after.fit,
            tuple((other.effect,) for other in every if other is not mine),
            _noise(found),
        )
        for mine in every
    )
    return _Question(contests, weights / weights.sum(), _critical(found))


def _wanted(found: Search, label: str) -> _Question:
    """One effect of plausible size against none."""
    look = found.after
    forms = {form.candidate for form in look.forms}
    labels = {look.candidates[i].label: i for i in sorted(forms)}
    if label not in labels:
        raise MechanismError(
            f"'{label}' is no effect that could be looked for here; these are: {', '.join(labels)}"
        )
    effect = look.form(labels[label]).effect
    size = np.array([c.start + c.plausible for c in effect.coefficients])
    contest = Contest(effect, size, look.fit, (), _noise(found))
    return _Question((contest,), np.ones(1), _critical(found))


def _noise(found: Search) -> float:
    fit = found.after.fit
    return max(fit.rss / max(fit.freedoms, 1), 1e-300)


def _critical(found: Search) -> float:
    """Chi-square of one coefficient at which something beside what is named stands out."""
    log_p = found.after.screen.threshold.critical(MORE)
    return float(ndtri(0.5 * np.exp(log_p))) ** 2


def _separable(
    asked: _Question, captured: Sequence[Array], sums: Sequence[Array], reach: Reach
) -> NDArray[np.bool_]:
    """(pairs,) which some number of poses would decide, spread over all that is feasible or at its ends."""
    u = reach.coordinates
    ends = np.unique(np.concatenate([u.argmin(axis=0), u.argmax(axis=0)]))
    found = [
        asked.decisive(
            [g + _UNENDING * s[where].mean(axis=0) for g, s in zip(captured, sums, strict=True)]
        )
        for where in (slice(None), ends)
    ]
    return np.asarray(np.maximum(*found) > 1.0)


def _chosen(captured: Sequence[Array], sums: Sequence[Array], merit: Merit, most: int) -> list[int]:
    """Indices of the poses: greedy, then each exchanged for a better one for as long as that helps."""
    chosen: list[int] = []

    def values(taken: Sequence[int]) -> Array:
        base = [g + s[list(taken)].sum(axis=0) for g, s in zip(captured, sums, strict=True)]
        found = merit([b + s for b, s in zip(base, sums, strict=True)])
        found[list(taken)] = -np.inf
        return found

    for _ in range(min(most, len(sums[0]))):
        chosen.append(int(np.argmax(values(chosen))))
    for _ in range(_EXCHANGES):
        before = list(chosen)
        for place in range(len(chosen)):
            found = values(chosen[:place] + chosen[place + 1 :])
            better = int(np.argmax(found))
            if found[better] > found[chosen[place]] + 1e-9:
                chosen[place] = better
        if chosen == before:
            break
    return chosen


def _pairs(
    asked: _Question,
    captured: Sequence[Array],
    proposed: Sequence[Array],
    each: Sequence[Array],
    separable: NDArray[np.bool_],
    count: int,
) -> tuple[Pair, ...]:
    """All pairs; ``each`` (P, m, m) are the sums of every feasible pose, its visits included."""
    rng = np.random.default_rng(0)
    poses = len(each[0])
    draws = [rng.choice(poses, count, replace=poses < count) for _ in range(_DRAWS)]
    numbers = np.unique(np.round(np.geomspace(1, _UNENDING, 60)))
    decisive = asked.decisive(proposed)
    out: list[Pair] = []
    for contest, old, new, sums in zip(asked.contests, captured, proposed, each, strict=True):
        now, then = contest.separation(old), contest.separation(new)
        drawn = np.median([contest.separation(old + sums[d].sum(axis=0)) for d in draws], axis=0)
        growth = contest.separation(old + numbers[:, None, None] * sums.mean(axis=0))
        for r, label in enumerate(contest.rivals or ("",)):
            enough = np.flatnonzero(growth[:, r] >= then[r])
            out.append(
                Pair(
                    contest.effect.label,
                    label,
                    float(now[r]),
                    float(then[r]),
                    float(drawn[r]),
                    float(numbers[enough[0]]) if len(enough) else np.inf,
                    bool(separable[len(out)]),
                    _power(float(decisive[len(out)]), asked.critical),
                )
            )
    return tuple(out)


def _power(decisive: float, critical: float) -> float:
    """That a normal deviate about the root of the separation goes beyond the critical one."""
    root, limit = np.sqrt(decisive * critical), np.sqrt(critical)
    return float(ndtr(root - limit) + ndtr(-root - limit))


def _chance(asked: _Question, pairs: Sequence[Pair]) -> float:
    """Of deciding all that poses can decide, by the weights of the hypotheses."""
    total = mass = 0.0
    for contest, weight in zip(asked.contests, asked.weights, strict=True):
        mine = [p.chance for p in pairs if p.effect == contest.effect.label and p.separable]
        if mine:
            total, mass = total + weight * min(mine), mass + weight
    return float(total / mass) if mass else 0.0
