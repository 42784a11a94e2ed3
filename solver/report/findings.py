"""What is worth knowing about a solve beyond its headline, in sentences, and what it cannot tell."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from solver.estimate.trust_region import Status
from solver.report.comparison import Compared, Value
from solver.report.misfit import judge, unseen_poses
from solver.report.notation import decimals_for, figures, signed, unit_of
from solver.solve import Solution

_SURPRISING = 3.0  # stated uncertainties of a nominal value
_CONFIDENT = 2.6  # standard errors that hold 99 % of truths
_MEMBER = 0.35  # share of the largest component that makes a parameter part of a combination


def findings(solution: Solution, rows: Sequence[Compared]) -> list[str]:
    """Sentences worth reading about ``solution``, whose identified parameters are ``rows``."""
    out = [found.text for found in solution.findings]
    out += [
        f"Not determined: {words}. Held at {by}."
        for words, by in zip(
            solution.identifiability.combinations, solution.identifiability.held_by, strict=True
        )
    ]
    if solution.estimate.status is Status.CONVERGED:
        out += _where_the_misfit_shows(solution) + _worst_combination(solution)
        out += _surprise(rows) + _agreements(solution, rows) + _against_truth(rows)
    lost = int((~solution.after.closed).sum())
    if lost:
        out.append(
            f"At {lost} pose{'' if lost == 1 else 's'} the loop does not close with the estimate; their residuals are not shown."
        )
    return out


def _surprise(rows: Sequence[Compared]) -> list[str]:
    stated = [(abs(row.change) / row.prior, row) for row in rows if row.prior]
    if not stated:
        return []
    most, row = max(stated, key=lambda pair: pair[0])
    moved = f"{signed(row.change, decimals_for(row.estimate.standard_error))} {row.unit.name}"
    tone = "more than it should" if most > _SURPRISING else "nothing unusual"
    return [
        f"Largest move for its stated uncertainty: {row.name}, {moved}, {figures(most, 2)} times that uncertainty; {tone}."
    ]


def _agreements(solution: Solution, rows: Sequence[Compared]) -> list[str]:
    return [
        _agreement(other.method, other.status, [(row, row.beside[k]) for row in rows])
        for k, other in enumerate(solution.beside)
    ]


def _against_truth(rows: Sequence[Compared]) -> list[str]:
    errors = [
        (abs(row.in_errors(row.estimate.value - row.truth)), row.name)
        for row in rows
        if row.truth is not None
    ]
    if not errors:
        return []
    most, name = max(errors)
    near = sum(error <= _CONFIDENT for error, _ in errors)
    return [
        f"Against the truth: {near} of {len(errors)} parameters lie within {_CONFIDENT} standard errors; "
        f"the farthest is {name} at {figures(most, 2)}."
    ]


def _where_the_misfit_shows(solution: Solution) -> list[str]:
    if judge(solution) != "above":
        return []
    left = np.sqrt(np.mean(solution.after.residual[solution.selection.poses] ** 2, axis=0))
    order = np.argsort(-left, kind="stable")[:2]
    told = " and ".join(
        f"{solution.table.channels[c]} ({figures(float(left[c]), 2)} standard errors RMS)"
        for c in order
    )
    return [f"What the model misses shows most at {told}; that need not be where its cause is."]


def _worst_combination(solution: Solution) -> list[str]:
    estimate, space = solution.estimate, solution.estimate.space
    plausible = solution.identifiability.plausible
    relative = estimate.spread / np.outer(plausible, plausible)
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
        size = np.sqrt(values[-1])
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
        if error > 0:
            apart.append((abs(other.value - row.estimate.value) / error, row.name))
    if not apart:
        return f"The method {method} gave no standard errors to compare by."
    most, name = max(apart)
    if most <= _CONFIDENT:
        return f"The method {method} agrees: at most {figures(most, 2)} standard errors apart, at {name}."
    return f"The method {method} disagrees: {figures(most, 2)} standard errors apart at {name}."


def limits(solution: Solution) -> list[str]:
    """What ``solution`` cannot tell."""
    inflation = solution.estimate.inflation
    errors = "Standard errors count sensor noise only: they say how far the estimate scatters, not how far the model is off."
    if inflation > 1.0:
        errors = (
            "What the model lacks. Standard errors are "
            f"{figures(inflation, 2)} times those of sensor noise to allow for it, but an error of the model can move a parameter by more."
        )
    alike = solution.estimate.correlation
    if alike is not None and alike.significant:
        errors = (
            "What the model lacks. Neighbouring poses leave residuals that are alike, so standard errors are "
            "widened by errors that poses share; they hold where poses like these are used and only as far as "
            "the model does: elsewhere, or in another fixture, an error of the model can move the result by more."
        )
    out = [
        errors,
        "Numbers of the rig that are not identified are taken as stated; if one is wrong, the error sits in the estimates.",
    ]
    if judge(solution) != "above":
        out.append(
            "A small misfit does not prove the model: an error that some combination of the parameters can imitate leaves no trace."
        )
    if not unseen_poses(solution):
        out.append(
            "All or nearly all usable poses were fitted, so the result has not been tested on unseen ones; use fewer with -n to see."
        )
    return out
