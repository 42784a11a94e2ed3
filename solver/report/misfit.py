"""How the misfit of a solve is judged: against its own scatter, and on poses that the fit has not seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import gammaincinv

from solver.solve import Solution

Judgement = Literal["noise", "above", "below", "unknown"]
"""What the misfit is, compared with sensor noise; unknown where no reading is left over to tell."""

_SCATTERS = 3.0  # standard deviations of chi-square per degree of freedom that noise may move it
_FEWEST_UNSEEN = 3


@dataclass(frozen=True, slots=True)
class Unseen:
    """How well the result explains the poses that were not used.

    Attributes:
        count: of those poses.
        misfit: their chi-square per degree of freedom.
        limit: the most that a fit as good as this one's should give.
    """

    count: int
    misfit: float
    limit: float


def scatter(solution: Solution) -> float:
    """Standard deviation of chi-square per degree of freedom where the model is right."""
    free = solution.estimate.freedoms
    return math.sqrt(2.0 / free) if free > 0 else math.inf


def unnoticed(freedoms: int) -> float:
    """How many times noise residuals may be, and still pass for noise with one chance in ten.

    The test is that of `Estimate.inflation`, at 99 % of chi-square: with few degrees of freedom
    it has little power, and a misfit of 1 says little.
    """
    if freedoms < 1:
        return math.inf
    most, least = (2.0 * float(gammaincinv(freedoms / 2.0, share)) for share in (0.99, 0.10))
    return math.sqrt(most / least)


def judge(solution: Solution) -> Judgement:
    """The misfit of ``solution``; above noise is what makes `Estimate.inflation` exceed 1."""
    misfit, margin = solution.estimate.misfit, _SCATTERS * scatter(solution)
    if not (math.isfinite(misfit) and math.isfinite(margin)):
        return "unknown"
    if solution.estimate.inflation > 1.0:
        return "above"
    return "below" if misfit < 1.0 - margin else "noise"


def unseen_poses(solution: Solution) -> Unseen | None:
    """The test on poses that were not used, or None where there are too few of them."""
    unseen = np.ones(len(solution.table.counts), dtype=bool)
    unseen[solution.selection.poses] = False
    unseen &= solution.after.closed
    count, equations = int(unseen.sum()), _equations_per_pose(solution)
    if count < _FEWEST_UNSEEN or equations < 1:
        return None
    free = count * equations
    misfit = float(np.sum(solution.after.residual[unseen] ** 2)) / free
    # The fit adapts to the poses it has seen, so that unseen ones do worse by the parameters' share.
    share = solution.identifiability.rank / max(solution.estimate.freedoms, 1)
    limit = max(solution.estimate.misfit, 1.0) * (1 + share + _SCATTERS * math.sqrt(2.0 / free))
    return Unseen(count, misfit, limit)


def _equations_per_pose(solution: Solution) -> int:
    """By how many readings a pose is over-determined."""
    parameters = solution.estimate.parameters
    freedoms = solution.model.mobility(solution.after.coordinates, parameters)
    return len(solution.table.channels) - freedoms
