"""Scores of a blind benchmark: what was sealed beside what was answered. Nothing else opens truths.

A case counts with the strength that its effect really had. Every rate has its 95 % interval after
Wilson (J. Am. Stat. Assoc. 22, 1927). An analysis that ended in an error detected nothing and named
nothing.

Two effects that leave the same trace cannot be told apart by anybody: where the best rival
leaves less than `TWIN` of the trace (beyond what the effect's own form leaves) the case is one
of near-twins, and the right answer is the group; from `APART` on it is the name. The scores of
naming are given for all cases, and for those that can be told apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.blind.grid import STRENGTHS, STRONG

TWIN = 4.0
"""Two standard deviations, squared: less does not tell two effects apart."""

APART = 25.0
"""Five standard deviations, squared: more ought to."""

CODED = ("stuck-bit", "saturation")
"""What raw codes show by themselves: however alike the traces, these have no twins."""

_Z = 1.959963984540054
_EDGES = np.sqrt(np.array(STRENGTHS[:-1]) * np.array(STRENGTHS[1:]))


@dataclass(frozen=True, slots=True)
class Rate:
    """``hits`` out of ``of``."""

    hits: int
    of: int

    @property
    def value(self) -> float | None:
        """None where there was no case."""
        return self.hits / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval after Wilson."""
        if not self.of:
            return 0.0, 1.0
        p, n = self.hits / self.of, self.of
        middle = (p + _Z**2 / (2 * n)) / (1 + _Z**2 / n)
        half = _Z / (1 + _Z**2 / n) * np.sqrt(p * (1 - p) / n + _Z**2 / (4 * n**2))
        return max(0.0, float(middle - half)), min(1.0, float(middle + half))


@dataclass(frozen=True, slots=True)
class Outcome:
    """One case, sealed and answered."""

    sealed: dict[str, Any]
    answer: dict[str, Any]

    @property
    def kind(self) -> str:
        """Of the case."""
        return str(self.sealed["kind"])

    @property
    def strength(self) -> float:
        """The wanted strength that the real one is nearest to; 0 of a null."""
        effects = self.sealed["effects"]
        if not effects:
            return 0.0
        weakest = min(effect["strength"] for effect in effects)
        return float(STRENGTHS[int(np.searchsorted(_EDGES, weakest))])

    @property
    def truths(self) -> tuple[str, ...]:
        """Labels of what is hidden."""
        return tuple(_label(effect) for effect in self.sealed["effects"])

    @property
    def verdict(self) -> str:
        """Of the solver."""
        return str(self.answer["verdict"])

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Of each effect in the answer, its label and those of what it could also be."""
        if self.verdict not in ("named", "ambiguous"):
            return ()
        return tuple(
            (_label(e), *(_label(rival) for rival in e["could_also_be"]))
            for e in self.answer["effects"]
        )

    @property
    def named(self) -> tuple[str, ...]:
        """Labels of what the answer believes in most."""
        return tuple(group[0] for group in self.groups)

    @property
    def detected(self) -> bool:
        """Whether the solver said that anything is missing."""
        return self.verdict in ("named", "ambiguous", "none-of-the-known")

    @property
    def right(self) -> bool:
        """Whether the answer is what is hidden and nothing else, rivals aside."""
        return sorted(self.named) == sorted(self.truths)

    @property
    def within(self) -> bool:
        """Whether all that is hidden is in the groups of an answer of as many effects."""
        return len(self.groups) == len(self.truths) and all(
            any(truth in group for group in self.groups) for truth in self.truths
        )

    @property
    def found(self) -> bool:
        """Whether all that is hidden is in the groups of the answer."""
        return all(any(truth in group for group in self.groups) for truth in self.truths)

    @property
    def wrong_alone(self) -> bool:
        """Whether the answer is one name without rivals, and a wrong one: the worst error."""
        return (
            len(self.groups) == 1
            and len(self.groups[0]) == 1
            and self.groups[0][0] not in self.truths
        )

    @property
    def apart(self) -> float:
        """What would tell a single effect from its nearest rival, squared, in noise units."""
        effect = self.sealed["effects"][0]
        own = effect["own_leaves"]
        return float(effect["nearest_leaves"] - (0.0 if own is None else own))

    @property
    def covered(self) -> bool | None:
        """Whether the 95 % interval of the size covers the truth; None where sizes do not compare."""
        truth = self.sealed["effects"][0]
        for effect in self.answer["effects"]:
            if _label(effect) == _label(truth) and effect["unit"] == truth["unit"]:
                off = abs(effect["size"]) - abs(truth["size"])
                return bool(abs(off) <= _Z * effect["standard_error"])
        return None


def _label(effect: dict[str, Any]) -> str:
    return f"{effect['name']}@{effect['where']}"


def outcomes(
    sealed: Iterable[dict[str, Any]], answers: Iterable[dict[str, Any]]
) -> tuple[Outcome, ...]:
    """Cases that were made and answered, in the order in which they were sealed."""
    said = {line["key"]: line for line in answers}
    return tuple(
        Outcome(line, said[line["key"]])
        for line in sealed
        if not line["left_out"] and line["key"] in said
    )


@dataclass(frozen=True, slots=True)
class Score:
    """One line of the table.

    Attributes:
        name: what is scored.
        value: a rate, or a plain number, or None where no case says anything.
        rate: behind a rate.
        least, most: to be reached.
    """

    name: str
    value: float | None
    rate: Rate | None
    least: float | None = None
    most: float | None = None

    @property
    def met(self) -> bool | None:
        """None where no case says anything or nothing is demanded."""
        if self.value is None or (self.least is None and self.most is None):
            return None
        return (self.least is None or self.value >= self.least) and (
            self.most is None or self.value <= self.most
        )


def scores(cases: Sequence[Outcome]) -> tuple[Score, ...]:
    """The table of scores."""
    singles = [c for c in cases if c.kind == "single"]
    clean = [c for c in cases if c.kind == "null" and c.sealed["noise"] == "clean"]
    ugly = [c for c in cases if c.kind == "null" and c.sealed["noise"] != "clean"]
    doubles = [c for c in cases if c.kind == "double"]
    strangers = [c for c in cases if c.kind == "outsider"]
    strong = [c for c in singles if c.strength >= STRONG]
    at25, at64 = ([c for c in singles if c.strength == s] for s in (25.0, 64.0))
    from64 = [c for c in singles if c.strength >= 64.0]
    twins = [c for c in from64 if c.apart < TWIN and c.sealed["effects"][0]["name"] not in CODED]

    def separable(some: Sequence[Outcome]) -> list[Outcome]:
        return [c for c in some if c.apart >= APART]

    right = [c for c in singles if c.right]
    sizes = [sum(map(len, c.groups)) for c in strong if c.groups]
    gaps = [c.answer["gap"] for c in strong if c.right and c.answer["gap"] is not None]
    closed = [g["closed"] for g in gaps if g["closed"] is not None]
    return (
        _rate("false naming, clean nulls", clean, lambda c: bool(c.groups), most=0.05),
        _rate("false naming, ugly nulls", ugly, lambda c: bool(c.groups), most=0.08),
        _rate("anything said to be missing, clean nulls", clean, lambda c: c.detected),
        _rate("anything said to be missing, ugly nulls", ugly, lambda c: c.detected),
        _rate("detection, strength 25", at25, lambda c: c.detected, least=0.85),
        _rate("detection, strength 64 and above", from64, lambda c: c.detected, least=0.98),
        _rate("right effect and place, strength 64", at64, lambda c: c.right, least=0.85),
        _rate("the same, where they can be told apart", separable(at64), lambda c: c.right),
        _rate("right effect and place, strength 225 and above", strong, lambda c: c.right, least=0.95),
        _rate("the same, where they can be told apart", separable(strong), lambda c: c.right),
        _rate("truth in the set of possible names, strength 225 and above", strong, lambda c: c.within, least=0.92),
        _mean("mean size of that set, strength 225 and above", sizes, most=2.0),
        _rate("a single wrong name", singles, lambda c: c.wrong_alone, most=0.03),
        _rate("near-twins reported as a group", twins, lambda c: c.within and len(c.groups[0]) > 1, least=0.95),
        _rate("none of the known, recognised", strangers, lambda c: c.verdict == "none-of-the-known", least=0.85),
        _rate("the same, where the nearest known effect leaves 64 or more", [c for c in strangers if c.apart >= 64.0], lambda c: c.verdict == "none-of-the-known"),
        _rate("none of the known, falsely said of a known effect", singles, lambda c: c.verdict == "none-of-the-known", most=0.07),
        _rate("both of a double", doubles, lambda c: c.found, least=0.75),
        _rate("95 % interval covers the size", [c for c in right if c.covered is not None], lambda c: bool(c.covered), least=0.92, most=0.97),
        _median("held-out gap closed, median, strength 225 and above", closed, least=0.90),
        _median("gap left on held-out poses, median, strength 225 and above", [g["after"] for g in gaps], most=1.1),
        _median("seconds of one processor for an analysis, median", [c.answer["seconds"] for c in cases]),
        _rate("analyses that ended in an error", cases, lambda c: c.verdict == "error"),
    )  # fmt: skip


def baseline_scores(cases: Sequence[Outcome]) -> dict[str, tuple[Score, ...]]:
    """The same of simpler methods, by their names: false naming, and the right name put first."""
    methods = sorted({name for c in cases for name in c.answer["baselines"]})
    return {method: _baseline(cases, method) for method in methods}


def _baseline(cases: Sequence[Outcome], method: str) -> tuple[Score, ...]:
    def said(c: Outcome) -> list[str]:
        return list(c.answer["baselines"].get(method, []))

    def right(c: Outcome) -> bool:
        return said(c)[: len(c.truths)] == list(c.truths)

    nulls = [c for c in cases if c.kind == "null" and c.sealed["noise"] == "clean"]
    ugly = [c for c in cases if c.kind == "null" and c.sealed["noise"] != "clean"]
    singles = [c for c in cases if c.kind == "single"]
    return (
        _rate("false naming, clean nulls", nulls, lambda c: bool(said(c))),
        _rate("false naming, ugly nulls", ugly, lambda c: bool(said(c))),
        _rate("right one first, strength 64", [c for c in singles if c.strength == 64.0], right),
        _rate(
            "right one first, strength 225 and above",
            [c for c in singles if c.strength >= STRONG],
            right,
        ),
        _rate(
            "right one and no other, strength 225 and above",
            [c for c in singles if c.strength >= STRONG],
            lambda c: said(c) == list(c.truths),
        ),
    )


def _rate(
    name: str,
    cases: Sequence[Outcome],
    hit: Callable[[Outcome], bool],
    *,
    least: float | None = None,
    most: float | None = None,
) -> Score:
    rate = Rate(sum(hit(c) for c in cases), len(cases))
    return Score(name, rate.value, rate, least, most)


def _mean(name: str, values: Sequence[float], *, most: float) -> Score:
    return Score(name, float(np.mean(values)) if values else None, None, None, most)


def _median(
    name: str, values: Sequence[float], *, least: float | None = None, most: float | None = None
) -> Score:
    return Score(name, float(np.median(values)) if values else None, None, least, most)
