"""Which combinations of parameters the data determine, decided against noise, and what holds the rest.

The Jacobian J is whitened: a unit of residual is one standard deviation. A direction v in
parameter space then has the standard error 1 / |J v|. It counts as not determined when that
error alone could move the parameters by more than they can plausibly be wrong: half a
radian, half the size of the mechanism, half the gain. No threshold on singular values is
involved, so that better sensors or more poses determine more.

What is not determined is held: the estimate is the one nearest to the nominal values, in
units of their stated uncertainties (plausible errors where none is stated), of all that
explain the readings equally well. That is the limit of Bayes' rule where the data say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.null_directions import NullDirection, PointFrames, readable
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_NUMERICAL = 1e-9  # relative size of a singular value that is only rounding

BY_NOMINAL = "nominal values"
BY_PRIORS = "stated uncertainties"


@dataclass(frozen=True)
class Identifiability:
    """Rank of a whitened Jacobian, and its null directions.

    Attributes:
        rank: number of directions determined.
        singular_values: (n,) of the Jacobian with columns in units of ``plausible``.
        held: (n, k), orthonormal in plausible units, the directions not determined.
        plausible: (n,) by how much each parameter may plausibly be wrong, SI.
        directions: k readable directions that span the same space.
        held_by: what holds each of them: stated uncertainties, where all its parameters have
            one, or nominal values, taken as exact.
    """

    rank: int
    singular_values: Array
    held: Array
    plausible: Array
    directions: tuple[NullDirection, ...]
    held_by: tuple[str, ...]

    @property
    def combinations(self) -> tuple[str, ...]:
        """The readable directions in words."""
        return tuple(direction.words for direction in self.directions)


def plausible_error(space: ParameterSpace) -> Array:
    """(n,) by how much each identified parameter may plausibly be wrong, SI."""
    lengths = [abs(p.nominal) for p in space.table if p.dimension == "length"]
    size = max([*lengths, 1e-3])
    out = []
    for i in space.identified:
        p = space.table[i]
        natural = {"angle": 0.5, "length": 0.5 * size}.get(p.dimension)
        if natural is None:
            # A ratio, a rate or a compliance has no natural size, may well be nominally zero, and
            # what is stated of it must leave it less uncertain than this.
            natural = max(0.5 * abs(p.nominal), 10.0 * (p.uncertainty or 0.0)) or 1.0
        out.append(natural)
    return np.array(out)


def undetermined(space: ParameterSpace, jacobian: Array) -> tuple[Array, Array]:
    """Directions (n, k) that a whitened Jacobian (M, n) leaves open, and all its singular values (n,).

    Both in plausible units; the directions are orthonormal.
    """
    plausible = plausible_error(space)
    if not len(plausible):
        return np.zeros((0, 0)), np.zeros(0)
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian * plausible, mode="r"))
    singular = np.concatenate([singular, np.zeros(len(plausible) - len(singular))])
    # In plausible units a direction of unit length is "as wrong as can be": one standard
    # deviation of evidence against it is the least that identification needs.
    determined = (singular > 1.0) & (singular > _NUMERICAL * singular[0])
    return right[~determined].T, singular


def identifiability(
    space: ParameterSpace,
    jacobian: Array,
    at: Array | None = None,
    frames: PointFrames | None = None,
) -> Identifiability:
    """Rank decision for a whitened Jacobian.

    Args:
        space: what is identified.
        jacobian: (M, n), SI columns.
        at: (N,) parameters at which it was taken; nominal by default.
        frames: the rig's points (`null_directions.point_frames`), which lets shifts, turns and
            scales of several of them be named.
    """
    plausible = plausible_error(space)
    held, singular = undetermined(space, jacobian)
    directions: tuple[NullDirection, ...] = ()
    if held.shape[1]:
        where = space.nominal if at is None else at
        directions = readable(space, held, plausible, where, frames or PointFrames({}))
    stated = dict(zip(space.names, np.isfinite(space.uncertainty), strict=True))
    held_by = tuple(
        BY_PRIORS if all(stated[name] for name in direction.members) else BY_NOMINAL
        for direction in directions
    )
    rank = len(plausible) - held.shape[1]
    return Identifiability(rank, singular, held, plausible, directions, held_by)


def prior_width(space: ParameterSpace) -> Array:
    """(n,) in which deviations from nominal are weighed: stated uncertainties, else plausible errors."""
    stated = space.uncertainty
    return np.where(np.isfinite(stated), stated, plausible_error(space))


def free_directions(held: Array, width: Array) -> Array:
    """(n, n - k) directions, SI, that leave the held ones (n, k), SI, where their priors put them.

    v with H' W^-2 v = 0: moving along v does not change how far the held directions are from
    nominal, measured by the prior widths W (n,).
    """
    count, size = held.shape
    basis = np.linalg.qr(held / width[:, None], mode="complete")[0][:, size:]
    return np.asarray(width[:, None] * basis).reshape(count, count - size)


def at_priors(values: Array, nominal: Array, held: Array, width: Array) -> Array:
    """(n,) ``values`` moved along the held directions (n, k), SI, to where the priors prefer them."""
    weighted = held / width[:, None]
    move = np.linalg.lstsq(weighted, (values - nominal) / width, rcond=None)[0]
    return np.asarray(values - held @ move)


def covariance(space: ParameterSpace, jacobian: Array) -> tuple[Array, Identifiability]:
    """(n, n) covariance from a whitened Jacobian (M, n), with what is held.

    Held directions whose parameters all have a stated uncertainty contribute that; others are
    taken as exact, so that standard errors then hold given the nominal values.
    """
    found = identifiability(space, jacobian)
    return covariance_holding(space, jacobian, found), found


def covariance_holding(space: ParameterSpace, jacobian: Array, found: Identifiability) -> Array:
    """(n, n) covariance from a whitened Jacobian (M, n), of which ``found`` says what is held, as `covariance`."""
    if jacobian.shape[1] == 0:
        return np.zeros((0, 0))
    width = prior_width(space)
    free = free_directions(found.plausible[:, None] * found.held, width)
    half = free @ np.linalg.inv(np.linalg.qr(jacobian @ free, mode="r"))
    believed = [
        direction.change
        for direction, by in zip(found.directions, found.held_by, strict=True)
        if by == BY_PRIORS
    ]
    if believed:
        weighted = np.column_stack(believed) / width[:, None]
        half = np.hstack([half, width[:, None] * np.linalg.qr(weighted)[0]])
    return half @ half.T
