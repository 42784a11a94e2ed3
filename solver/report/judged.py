"""The Jacobians by which a solve judges its poses, and their observability, under names people know."""

from __future__ import annotations

from dataclasses import dataclass

from solver.estimate import hinge, likelihood, multi_loop
from solver.poses.observability import Observability, observability
from solver.solve import Solution

_RESIDUALS = {
    likelihood.NAME: "readings, in standard deviations",
    hinge.NAME: "closure errors, in m and rad",
    multi_loop.NAME: "closure errors, in m²",
}


@dataclass(frozen=True, slots=True)
class Judged:
    """Observability of one Jacobian.

    Attributes:
        method: whose Jacobian it is.
        residual: what it is the derivative of, and in which unit.
        raw: with SI columns.
        scaled: with unit columns.
    """

    method: str
    residual: str
    raw: Observability
    scaled: Observability


def judged(solution: Solution) -> tuple[Judged, ...]:
    """The Jacobian that judges the poses of ``solution``, then those of the other methods."""
    estimate = solution.estimate
    # Poses of a hinged arm are judged by closure errors whatever the method: see `Solution.raw`.
    by_closure = solution.closure_after is not None
    first = hinge.NAME if by_closure else estimate.method
    out = [Judged(first, _residual(first), solution.raw, solution.scaled)]
    out += [
        Judged(
            method.method,
            _residual(method.method),
            observability(method.jacobian, scaled=False),
            observability(method.jacobian, scaled=True),
        )
        for method in (estimate, *solution.beside)
        if method.method != first
    ]
    return tuple(out)


def _residual(method: str) -> str:
    return _RESIDUALS.get(method, "the method's own residual")
