"""Which combinations of parameters the data determine, decided against noise, and named.

The Jacobian J is whitened: a unit of residual is one standard deviation. A direction v in
parameter space has the standard error 1 / |J v|. It counts as not identifiable when that
error, at one standard deviation, moves some parameter by more than anyone could be wrong
about it: its prior uncertainty where stated, else half a radian, half the size of the
mechanism, half the gain. Such directions are held at their priors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_NUMERICAL = 1e-9  # relative size of a singular value that is only rounding


@dataclass(frozen=True)
class Identifiability:
    """Rank of a whitened Jacobian, and its null directions.

    Attributes:
        rank: number of directions determined.
        singular_values: (n,) of the Jacobian with columns in units of ``plausible``.
        held: (n, k), orthonormal in plausible units, the directions not determined.
        plausible: (n,) by how much each parameter may plausibly be wrong, SI.
        combinations: a sentence for each held direction.
    """

    rank: int
    singular_values: Array
    held: Array
    plausible: Array
    combinations: tuple[str, ...]


def plausible_error(space: ParameterSpace) -> Array:
    """(n,) by how much each identified parameter may plausibly be wrong, SI."""
    lengths = [abs(p.nominal) for p in space.table if p.dimension == "length"]
    size = max([*lengths, 1e-3])
    out = []
    for i in space.identified:
        p = space.table[i]
        natural = {"angle": 0.5, "length": 0.5 * size}.get(p.dimension, 0.5 * abs(p.nominal))
        out.append(natural)
    return np.array(out)


def identifiability(space: ParameterSpace, jacobian: Array) -> Identifiability:
    """Rank decision for a whitened Jacobian (M, n) with SI columns."""
    plausible = plausible_error(space)
    if jacobian.shape[1] == 0:
        return Identifiability(0, np.zeros(0), np.zeros((0, 0)), plausible, ())
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian * plausible, mode="r"))
    singular = np.concatenate([singular, np.zeros(len(plausible) - len(singular))])
    # In plausible units a direction of unit length is "as wrong as can be": one standard
    # deviation of evidence against it is the least that identification needs.
    determined = (singular > 1.0) & (singular > _NUMERICAL * singular[0])
    held = right[~determined].T
    return Identifiability(
        int(determined.sum()),
        singular,
        held,
        plausible,
        tuple(_name(space, column, plausible) for column in held.T),
    )


def covariance(space: ParameterSpace, jacobian: Array) -> tuple[Array, Identifiability]:
    """(n, n) covariance from a whitened Jacobian; held directions contribute nothing to it."""
    found = identifiability(space, jacobian)
    if jacobian.shape[1] == 0:
        return np.zeros((0, 0)), found
    keep = np.linalg.qr(np.hstack([found.held, np.eye(len(found.plausible))]))[0][
        :, found.held.shape[1] :
    ]
    reduced = (jacobian * found.plausible) @ keep
    triangle = np.linalg.qr(reduced, mode="r")
    half = found.plausible[:, None] * keep @ np.linalg.inv(triangle)
    return half @ half.T, found


def _name(space: ParameterSpace, direction: Array, plausible: Array) -> str:
    """A held direction in the rig's own terms, its largest members first."""
    scaled = direction * plausible
    members = [
        i
        for i in np.argsort(-np.abs(direction))
        if abs(direction[i]) > 0.02 * np.abs(direction).max()
    ]
    if len(members) == 1:
        return f"{space.names[members[0]]} (no pose shows it)"
    lead = scaled[members[0]]
    terms = []
    for i in members[:6]:
        ratio = scaled[i] / lead
        dimension = space.table[space.identified[i]].dimension
        same = dimension == space.table[space.identified[members[0]]].dimension
        terms.append(
            f"{ratio:+.3g} {space.names[i]}" if same else f"{ratio:+.3g} SI {space.names[i]}"
        )
    more = f" and {len(members) - 6} more" if len(members) > 6 else ""
    return " ".join(terms).lstrip("+").strip() + more
