"""What a solve is worth: one sentence, the numbers behind it, and how to take each of them.

A condition number with unit columns below 100 counts as acceptable, as in Giugovaz & Hollerbach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from solver.estimate.trust_region import Status
from solver.report.comparison import Compared
from solver.report.findings import findings, limits
from solver.report.misfit import judge, scatter, unnoticed, unseen_poses
from solver.report.notation import figures
from solver.solve import Solution

ACCEPTABLE_CONDITION = 100.0
"""Largest condition number, columns scaled, that counts as acceptable."""

SHARP = 2.0
"""Residuals this many times noise must be noticed before a misfit counts as a check of the model."""

Grade = Literal["good", "caution", "bad"]


@dataclass(frozen=True, slots=True)
class Fact:
    """One number of the headline, and how to take it."""

    label: str
    value: str
    note: str
    grade: Grade


@dataclass(frozen=True, slots=True)
class Verdict:
    """A solve in words.

    Attributes:
        grade: of the whole.
        headline: one sentence.
        remedy: what to do where there is no result, or None.
        facts: the numbers behind it.
        findings: sentences worth reading.
        limits: what this solve cannot tell.
    """

    grade: Grade
    headline: str
    remedy: str | None
    facts: tuple[Fact, ...]
    findings: tuple[str, ...]
    limits: tuple[str, ...]


def verdict(solution: Solution, rows: Sequence[Compared]) -> Verdict:
    """The verdict on ``solution``, whose identified parameters are ``rows``."""
    estimate = solution.estimate
    converged = estimate.status is Status.CONVERGED
    facts = (
        _status(solution),
        _misfit(solution),
        _poses(solution),
        _condition(solution),
        *_alike(solution),
        *_unseen(solution),
    )
    grade: Grade = "good"
    if any(fact.grade != "good" for fact in facts) or (
        solution.identifiability.combinations or solution.findings
    ):
        grade = "caution"
    if not converged:
        grade = "bad"
    return Verdict(
        grade=grade,
        headline=_headline(solution),
        remedy=None if converged else estimate.status.value,
        facts=facts,
        findings=tuple(findings(solution, rows)),
        limits=tuple(limits(solution)),
    )


def certificate(solution: Solution) -> str:
    """How near the selected poses come to the best that any selection could reach."""
    chosen, usable = len(solution.selection.poses), len(solution.table.counts)
    if chosen >= usable:
        return f"all {usable} usable poses were taken, so there was nothing to choose"
    bound = solution.selection.upper_bound
    if not (math.isfinite(bound) and bound > 0):
        return f"no bound is known on what the best {chosen} of these {usable} poses could give"
    gap = math.ceil(1e3 * (1.0 - solution.selection.value / bound) - 1e-9) / 10.0
    return (
        f"within {max(gap, 0.1):.1f} % of the best any {chosen} of these {usable} poses could give"
    )


_NO_RESULT = {
    Status.UNEXPLAINED: "No result: the mechanism as described does not explain the readings.",
    Status.OUTLYING: "No result: a few poses contradict all the others.",
    Status.FAR_FROM_NOMINAL: "No result: the answer found lies implausibly far from the nominal values.",
    Status.UNDETERMINED: "No result: these poses determine none of the parameters.",
}


def _headline(solution: Solution) -> str:
    estimate = solution.estimate
    if estimate.status is not Status.CONVERGED:
        return _NO_RESULT.get(
            estimate.status, "No result: the search for the parameters did not converge."
        )
    held = len(solution.identifiability.combinations)
    if held:
        combinations = "combination" if held == 1 else "combinations"
        return f"Calibrated in part: these poses leave {held} {combinations} of parameters undetermined."
    match judge(solution):
        case "above":
            return (
                "Calibrated, but the model does not explain the readings: what is left is "
                f"{figures(math.sqrt(estimate.misfit), 2)} times what sensor noise leaves."
            )
        case "below":
            return "Calibrated; the readings fit better than their own noise should allow."
        case "unknown":
            return "Calibrated, with no reading to spare for checking the model."
    hidden = unnoticed(estimate.freedoms)
    if hidden > SHARP:
        count = estimate.freedoms
        return (
            f"Calibrated, but hardly checked: with {count} degree{'' if count == 1 else 's'} of freedom to spare, "
            f"residuals {figures(hidden, 2)} times sensor noise could pass unnoticed."
        )
    if estimate.correlation is not None and estimate.correlation.significant:
        return (
            "Calibrated, but neighbouring poses leave residuals that are alike: something that varies "
            "with the pose is missing from the model."
        )
    if not solution.scaled.condition <= ACCEPTABLE_CONDITION:
        return "Calibrated to sensor noise, but these poses show some parameters only weakly."
    return "Calibrated: the model explains the readings to within sensor noise."


def _status(solution: Solution) -> Fact:
    estimate = solution.estimate
    steps = f"{estimate.iterations} step" + ("" if estimate.iterations == 1 else "s")
    converged = estimate.status is Status.CONVERGED
    return Fact(
        "Search",
        estimate.status.word.replace("-", " "),
        f"after {steps}, method {estimate.method}",
        "good" if converged else "bad",
    )


def _misfit(solution: Solution) -> Fact:
    judged = judge(solution)
    low, high = (max(1.0 + sign * 2 * scatter(solution), 0.0) for sign in (-1, 1))
    return Fact(
        "Misfit χ²/dof",
        figures(solution.estimate.misfit),
        "no reading is left over to tell"
        if judged == "unknown"
        else f"noise alone gives 1 ({low:.2f} to {high:.2f}); {_power(solution)}",
        "good"
        if judged == "noise" and unnoticed(solution.estimate.freedoms) <= SHARP
        else "caution",
    )


def _power(solution: Solution) -> str:
    free = solution.estimate.freedoms
    return (
        f"{free} degree{'' if free == 1 else 's'} of freedom: residuals "
        f"{figures(unnoticed(free), 2)} times noise would be noticed nine times in ten"
    )


def _alike(solution: Solution) -> tuple[Fact, ...]:
    alike = solution.estimate.correlation
    if alike is None or not alike.significant:
        return ()
    return (
        Fact(
            "Neighbouring poses",
            figures(alike.score, 2),
            "standard deviations by which their residuals are more alike than noise; intervals are wider for it",
            "caution",
        ),
    )


def _poses(solution: Solution) -> Fact:
    used = len(solution.selection.poses) - solution.estimate.left_out
    usable, rejected = len(solution.table.counts), len(solution.table.rejected)
    notes = []
    if rejected:
        notes.append(f"{rejected} more dwell{'' if rejected == 1 else 's'} rejected")
    if solution.estimate.left_out:
        notes.append(f"{solution.estimate.left_out} left out by the method")
    return Fact(
        "Poses used",
        f"{used} of {usable}",
        ", ".join(notes) or "no dwell rejected",
        "caution" if rejected > usable else "good",
    )


def _condition(solution: Solution) -> Fact:
    condition = solution.scaled.condition
    good = condition <= ACCEPTABLE_CONDITION
    return Fact(
        "Condition number",
        figures(condition),
        f"{'acceptable' if good else 'not acceptable'}: the limit is {ACCEPTABLE_CONDITION:.0f}, columns scaled",
        "good" if good else "caution",
    )


def _unseen(solution: Solution) -> tuple[Fact, ...]:
    found = unseen_poses(solution)
    if found is None:
        return ()
    return (
        Fact(
            "Unseen poses",
            figures(found.misfit),
            f"χ²/dof of the {found.count} poses that were not used",
            "good" if found.misfit <= found.limit else "caution",
        ),
    )
