"""What makes a set of poses good: four criteria of its information matrix, and where each of them climbs.

With M the sum of the poses' information (n, n) and lambda its eigenvalues:

    sigma_L       sqrt(lambda_min)             the worst direction (Nahvi et al., equation 12)
    determinant   det(M)^(1 / 2n)              the volume of the confidence region (D-optimality)
    trace         sqrt(n / trace(M^-1))        the mean square standard error (A-optimality)
    condition     sqrt(lambda_min/lambda_max)  1 over the condition number (equation 14)

All are larger for better sets. The squares of the first three are concave and homogeneous of
degree one in M, so that with any supergradient Z taken at any M, phi(S) <= <Z, S> for every
S: the sum of the N largest <Z, M_i> bounds every set of N poses. The condition number is a
ratio lambda_min / lambda_max, and for Z, Y >= 0 of trace 1 at most <Z, S> / <Y, S>.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from solver.errors import SolverError

Array = NDArray[np.float64]

Criterion = Literal["sigma_L", "determinant", "trace", "condition"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)
"""The default first."""

IN_WORDS: dict[Criterion, str] = {
    "sigma_L": "the smallest singular value",
    "determinant": "the geometric mean of the singular values",
    "trace": "the harmonic mean square of the singular values",
    "condition": "the smallest over the largest singular value",
}
"""Of the identification Jacobian: what each criterion makes large."""

_FLOOR = 1e-12  # of the largest eigenvalue: a direction that no pose shows
_SOFT = 0.05  # width of the soft extremes, of the extreme itself


def criterion_named(name: str) -> Criterion:
    """The criterion called ``name``; raises SolverError with the names there are."""
    for known in CRITERIA:
        if known == name:
            return known
    raise SolverError(f"there is no criterion '{name}'; criteria: {', '.join(CRITERIA)}")


def worth(criterion: Criterion, information: Array) -> Array:
    """The square of the criterion for information matrices (..., n, n), as an array (...)."""
    values = np.maximum(np.linalg.eigvalsh(information), 0.0)
    highest = values[..., -1]
    if criterion == "sigma_L":
        return np.asarray(values[..., 0])
    if criterion == "condition":
        return np.asarray(values[..., 0] / np.where(highest > 0, highest, 1.0))
    with np.errstate(divide="ignore"):
        if criterion == "determinant":
            return np.asarray(np.exp(np.mean(np.log(values), axis=-1)))
        return np.asarray(values.shape[-1] / np.sum(1.0 / values, axis=-1))


def uphill(criterion: Criterion, information: Array) -> Array:
    """(n, n) Z: a pose adds about <Z, M_i> to the criterion's square at ``information`` (n, n).

    A supergradient for "determinant" and "trace". Where the criterion is an extreme
    eigenvalue, a soft one: directions near the extreme count too.
    """
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, _FLOOR * max(values[-1], 1e-300))
    count = len(values)
    if criterion == "determinant":
        along = np.exp(np.mean(np.log(values))) / (count * values)
    elif criterion == "trace":
        along = count / (values * np.sum(1.0 / values)) ** 2
    else:
        along = np.exp(-(values - values[0]) / (_SOFT * values[0]))
        along /= along.sum()
        if criterion == "condition":
            above = np.exp((values - values[-1]) / (_SOFT * values[-1]))
            along = along - values[0] / values[-1] * above / above.sum()
    return np.asarray((vectors * along) @ vectors.T)
