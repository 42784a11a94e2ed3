"""What a solve is worth, in words: did it work, how good is it, and what it cannot tell.

Owns the thresholds behind the words. Misfit is judged against its own scatter; a condition
number with unit columns below 100 counts as acceptable (Giugovaz & Hollerbach, section 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver.estimate.trust_region import Status
from solver.report.comparison import Compared, Value
from solver.report.notation import decimals_for, figures, signed, unit_of
from solver.solve import Solution

ACCEPTABLE_CONDITION = 100.0
"""Largest condition number, columns scaled, that counts as acceptable."""

Grade = Literal["good", "caution", "bad"]

_SCATTERS = 3.0  # standard deviations of chi-square per degree of freedom that noise may move it
_SURPRISING = 3.0  # stated uncertainties of a nominal value
_CONFIDENT = 2.6  # standard errors that hold 99 % of truths
_FEWEST_UNSEEN = 3
_MEMBER = 0.35  # share of the largest component that makes a parameter part of a combination


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
        *_unseen(solution),
    )
    grade: Grade = "good"
    if any(fact.grade != "good" for fact in facts) or solution.identifiability.combinations:
        grade = "caution"
    if not converged:
        grade = "bad"
    return Verdict(
        grade=grade,
        headline=_headline(solution),
        remedy=None if converged else estimate.status.value,
        facts=facts,
        findings=tuple(_findings(solution, rows)),
        limits=tuple(_limits(solution)),
    )


def equations_per_pose(solution: Solution) -> int:
    """By how many readings a pose is over-determined."""
    parameters = solution.estimate.parameters
    freedoms = solution.model.mobility(solution.after.coordinates, parameters)
    return len(solution.table.channels) - freedoms


def scatter(solution: Solution) -> float:
    """Standard deviation of chi-square per degree of freedom where the model is right."""
    free = solution.estimate.freedoms
    return math.sqrt(2.0 / free) if free > 0 else math.inf


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


def _headline(solution: Solution) -> str:
    estimate = solution.estimate
    if estimate.status is not Status.CONVERGED:
        return "No result: the search for the parameters did not converge."
    held = len(solution.identifiability.combinations)
    if held:
        combinations = "combination" if held == 1 else "combinations"
        return f"Calibrated in part: these poses leave {held} {combinations} of parameters undetermined."
    match _judge(solution):
        case "above":
            return (
                "Calibrated, but the model does not explain the readings: what is left is "
                f"{figures(math.sqrt(estimate.misfit), 2)} times what sensor noise leaves."
            )
        case "below":
            return "Calibrated; the readings fit better than their own noise should allow."
        case "unknown":
            return "Calibrated, with no reading to spare for checking the model."
    if not solution.scaled.condition <= ACCEPTABLE_CONDITION:
        return "Calibrated to sensor noise, but these poses show some parameters only weakly."
    return "Calibrated: the model explains the readings to within sensor noise."


def _judge(solution: Solution) -> Literal["noise", "above", "below", "unknown"]:
    misfit, margin = solution.estimate.misfit, _SCATTERS * scatter(solution)
    if not (math.isfinite(misfit) and math.isfinite(margin)):
        return "unknown"
    if solution.estimate.inflation > 1.0:
        return "above"
    return "below" if misfit < 1.0 - margin else "noise"


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
    judged = _judge(solution)
    low, high = (max(1.0 + sign * 2 * scatter(solution), 0.0) for sign in (-1, 1))
    return Fact(
        "Misfit χ²/dof",
        figures(solution.estimate.misfit),
        "no reading is left over to tell"
        if judged == "unknown"
        else f"noise alone gives 1 ({low:.2f} to {high:.2f})",
        "good" if judged == "noise" else "caution",
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
    """The misfit of poses that the fit has not seen, where there are some."""
    unseen = np.ones(len(solution.table.counts), dtype=bool)
    unseen[solution.selection.poses] = False
    unseen &= solution.after.closed
    count, equations = int(unseen.sum()), equations_per_pose(solution)
    if count < _FEWEST_UNSEEN or equations < 1:
        return ()
    free = count * equations
    misfit = float(np.sum(solution.after.residual[unseen] ** 2)) / free
    # The fit adapts to the poses it has seen, so that unseen ones do worse by the parameters' share.
    share = solution.identifiability.rank / max(solution.estimate.freedoms, 1)
    limit = max(solution.estimate.misfit, 1.0) * (1 + share + _SCATTERS * math.sqrt(2.0 / free))
    return (
        Fact(
            "Unseen poses",
            figures(misfit),
            f"χ²/dof of the {count} poses that were not used",
            "good" if misfit <= limit else "caution",
        ),
    )


def _findings(solution: Solution, rows: Sequence[Compared]) -> list[str]:
    out = [
        f"Not determined: {words}. Held at nominal values."
        for words in solution.identifiability.combinations
    ]
    out += _worst_combination(solution)
    stated = [(abs(row.change) / row.prior, row) for row in rows if row.prior]
    if stated:
        most, row = max(stated, key=lambda pair: pair[0])
        moved = f"{signed(row.change, decimals_for(row.estimate.standard_error))} {row.unit.name}"
        tone = "more than it should" if most > _SURPRISING else "nothing unusual"
        out.append(
            f"Largest move for its stated uncertainty: {row.name}, {moved}, {figures(most, 2)} times that uncertainty; {tone}."
        )
    for k, other in enumerate(solution.beside):
        out.append(_agreement(other.method, other.status, [(row, row.beside[k]) for row in rows]))
    known = [row for row in rows if row.truth is not None]
    if known:
        errors = np.array(
            [abs(row.in_errors(row.estimate.value - (row.truth or 0.0))) for row in known]
        )
        worst = int(np.nanargmax(errors)) if np.isfinite(errors).any() else 0
        out.append(
            f"Against the truth: {int((errors <= _CONFIDENT).sum())} of {len(known)} parameters lie within {_CONFIDENT} "
            f"standard errors; the farthest is {known[worst].name} at {figures(float(errors[worst]), 2)}."
        )
    lost = int((~solution.after.closed).sum())
    if lost:
        out.append(
            f"At {lost} pose{'' if lost == 1 else 's'} the loop does not close with the estimate; their residuals are not shown."
        )
    return out


def _worst_combination(solution: Solution) -> list[str]:
    estimate, space = solution.estimate, solution.estimate.space
    plausible = solution.identifiability.plausible
    relative = estimate.covariance / np.outer(plausible, plausible)
    if not np.isfinite(relative).all():
        return []
    values, vectors = np.linalg.eigh(relative)
    direction = vectors[:, -1]
    order = np.argsort(-np.abs(direction), kind="stable")
    direction = direction * np.sign(direction[order[0]])
    members = [j for j in order if abs(direction[j]) > _MEMBER * abs(direction[order[0]])][:3]
    moves = []
    for j in members:
        unit = unit_of(space.table[space.identified[j]])
        size = estimate.inflation * np.sqrt(values[-1])
        move = float(size * direction[j] * plausible[j] / unit.to_si)
        moves.append(
            f"{space.names[j]} {signed(move, min(decimals_for(abs(move)), 6))} {unit.name}"
        )
    together = " with " + " and ".join(moves[1:]) if len(moves) > 1 else ""
    return [f"Least certain: {moves[0]}{together}; one standard error of the worst combination."]


def _agreement(method: str, status: Status, pairs: Sequence[tuple[Compared, Value]]) -> str:
    if status is not Status.CONVERGED:
        return f"The method {method} gave no result to compare with: {status.value}."
    apart = []
    for row, other in pairs:
        error = math.hypot(row.estimate.standard_error, other.standard_error)
        apart.append((abs(other.value - row.estimate.value) / error, row.name))
    most, name = max(apart, key=lambda pair: pair[0])
    if most <= _CONFIDENT:
        return f"The method {method} agrees: at most {figures(most, 2)} standard errors apart, at {name}."
    return f"The method {method} disagrees: {figures(most, 2)} standard errors apart at {name}."


def _limits(solution: Solution) -> list[str]:
    inflation = solution.estimate.inflation
    errors = "Standard errors count sensor noise only: they say how far the estimate scatters, not how far the model is off."
    if inflation > 1.0:
        errors = (
            "What the model lacks. Standard errors are "
            f"{figures(inflation, 2)} times those of sensor noise to allow for it, but an error of the model can move a parameter by more."
        )
    out = [
        errors,
        "Numbers of the rig that are not identified are taken as stated; if one is wrong, the error sits in the estimates.",
        "A small misfit does not prove the model: an error that some combination of the parameters can imitate leaves no trace.",
    ]
    if not _unseen(solution):
        out.append(
            "All or nearly all usable poses were fitted, so the result has not been tested on unseen ones; use fewer with -n to see."
        )
    return out
