"""The multiple-loop method of Nahvi, Hollerbach & Hayward: each leg against the other three.

The plate is pivoted at O and has two points B1, B2, each held by two legs. The residual of
leg i is |B - A_i|^2 - d_i^2, with B found by intersecting spheres without using leg i
(equation 4). Plain least squares; its four residuals share one redundant measurement a
pose, so their covariance is singular, and the propagated standard errors say so.

Of the two intersections, B of a pair of legs lies on the plate's neutral side of the plane
O A A; the second point, found from k3, is the one nearer to where its own pair of legs puts it.
Poses at which three spheres (nearly) touch instead of crossing are left out and counted: there
the intersection is not a smooth function of the lengths.

From nominal values the method often ends in a false minimum, or at the edge of existence of a
pose. It starts from the maximum-likelihood result and takes its branches from the poses there,
so that what is compared between methods is where they end, not where they begin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.errors import MethodError
from solver.estimate import likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.gauss_newton import Closure, expected_cost, gauss_newton_step, propagate, solve
from solver.estimate.nuisance import Observations
from solver.estimate.trust_region import Status
from solver.mechanism.model import Model
from solver.mechanism.platform import PlatformModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

NAME = "multi-loop"

_CROSSING = 0.01  # spheres cross clearly when the height above their centres' plane exceeds a tenth of the radius


def fits(model: Model) -> bool:
    """Whether the method applies to ``model``."""
    return isinstance(model, PlatformModel) and _pairs(model) is not None


def _pairs(model: PlatformModel) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Channels of the legs at each of the two plate points, or None where there are not two pairs."""
    if not (model.turns and not model.shifts and len(model.plate) == 4):
        return None
    first = [i for i in range(4) if (model.plate[i] == model.plate[0]).all()]
    second = [i for i in range(4) if i not in first]
    if len(first) != 2 or not (model.plate[second[0]] == model.plate[second[1]]).all():
        return None
    return (first[0], first[1]), (second[0], second[1])


@dataclass(frozen=True)
class Traced:
    """A quantity at P poses with its derivatives by all parameters (N) and by leg lengths (4).

    value: (P, k); by_parameters: (P, k, N); by_lengths: (P, k, 4).
    """

    value: Array
    by_parameters: Array
    by_lengths: Array

    def __sub__(self, other: Traced) -> Traced:
        return Traced(
            self.value - other.value,
            self.by_parameters - other.by_parameters,
            self.by_lengths - other.by_lengths,
        )

    def square(self) -> Traced:
        """Squared norm, k = 1."""
        return Traced(
            np.sum(self.value**2, axis=1, keepdims=True),
            2 * np.einsum("pk,pkn->pn", self.value, self.by_parameters)[:, None],
            2 * np.einsum("pk,pkn->pn", self.value, self.by_lengths)[:, None],
        )


def intersect(
    centres: tuple[Traced, Traced], squares: tuple[Traced, Traced, Traced], side: Array
) -> tuple[Traced, NDArray[np.bool_]]:
    """Where three spheres meet: about O, about ``centres[0]`` and about ``centres[1]``.

    Args:
        centres: two sphere centres; the first sphere is centred at O.
        squares: squared radii of the three.
        side: (P, 3), of the two intersections the one nearer to this point is returned.

    Returns:
        The intersection, and at which poses (P,) the spheres clearly cross; elsewhere the
        values mean nothing.
    """
    c1, c2 = centres[0].value, centres[1].value
    r0, r1, r2 = (s.value[:, 0] for s in squares)
    normal = np.cross(c1, c2)
    long = np.sum(normal**2, axis=1)
    # B . c = (r0^2 + |c|^2 - r^2) / 2 for both centres, then the part along the normal.
    b1 = 0.5 * (r0 + np.sum(c1**2, axis=1) - r1)
    b2 = 0.5 * (r0 + np.sum(c2**2, axis=1) - r2)
    flat = (b1[:, None] * np.cross(c2, normal) + b2[:, None] * np.cross(normal, c1)) / long[:, None]
    height = r0 - np.sum(flat**2, axis=1)
    crossing = height > _CROSSING * r0
    rise = normal * np.sqrt(np.where(crossing, height, r0) / long)[:, None]
    sign = np.where(np.sum(rise * side, axis=1) >= 0, 1.0, -1.0)
    point = flat + sign[:, None] * rise
    # Implicitly: 2 B.dB = d r0^2;  2 (B - c).(dB - dc) = d r^2.
    matrix = np.stack([point, point - c1, point - c2], axis=1)

    def follow(part: str) -> Array:
        right = [0.5 * getattr(squares[0], part)[:, 0]]
        for centre, square in zip(centres, squares[1:], strict=True):
            arm = point - centre.value
            right.append(
                0.5 * getattr(square, part)[:, 0]
                + np.einsum("pk,pkn->pn", arm, getattr(centre, part))
            )
        return np.linalg.solve(matrix, np.stack(right, axis=1))

    return Traced(point, follow("by_parameters"), follow("by_lengths")), crossing


def residual(
    model: PlatformModel, counts: Array, parameters: Array, expansion: Array, near: Array
) -> tuple[Closure, NDArray[np.bool_]]:
    """Equation (4) at measured ``counts`` (P, 4), and at which poses (P,) it exists.

    Args:
        model: the platform.
        counts: (P, 4).
        parameters: (N,).
        expansion: (N, n).
        near: (P, 2, 3) [m], roughly where B1 and B2 are: it decides the branch.
    """
    pairs = _pairs(model)
    if pairs is None:
        raise MethodError(
            "the method 'multi-loop' needs a pivoted plate with two points, two legs at each"
        )
    poses, total = len(counts), len(parameters)
    lengths = model.sensing.values(counts, parameters)

    def entry(indices: NDArray[np.intp]) -> Traced:
        by = np.zeros((poses, 3, total))
        by[:, np.arange(3), indices] = 1.0
        return Traced(np.tile(parameters[indices], (poses, 1)), by, np.zeros((poses, 3, 4)))

    base = [entry(model.base[i]) for i in range(4)]
    plate = [entry(model.plate[pair[0]]) for pair in pairs]
    k = [point.square() for point in plate]
    k3 = (plate[0] - plate[1]).square()
    d = []
    for i in range(4):
        by_length = np.zeros((poses, 1, 4))
        by_length[:, 0, i] = 2 * lengths[:, i]
        d.append(Traced(lengths[:, i : i + 1] ** 2, np.zeros((poses, 1, total)), by_length))

    exists = np.ones(poses, dtype=bool)
    own = []
    for j, (a, b) in enumerate(pairs):
        point, crossing = intersect((base[a], base[b]), (k[j], d[a], d[b]), near[:, j])
        exists &= crossing
        own.append(point)
    rows: list[Traced | None] = [None] * 4
    for j, pair in enumerate(pairs):
        for left_out, used in (pair, pair[::-1]):
            point, crossing = intersect((base[used], own[1 - j]), (k[j], d[used], k3), near[:, j])
            exists &= crossing
            gap = (point - base[left_out]).square() - d[left_out]
            rows[left_out] = gap
    stacked = [row for row in rows if row is not None]
    by_lengths = np.concatenate([row.by_lengths for row in stacked], axis=1)
    by_parameters = np.concatenate([row.by_parameters for row in stacked], axis=1)
    closure = Closure(
        np.concatenate([row.value for row in stacked], axis=1),
        by_parameters @ expansion + by_lengths @ model.sensing.by_parameters(counts, expansion),
        by_lengths * parameters[model.sensing.gain],
    )
    return closure, exists


def identify(model: Model, space: ParameterSpace, observed: Observations) -> Estimate:
    """Parameters by the multiple-loop method.

    Raises:
        MethodError: the mechanism is not a pivoted plate on two pairs of legs.
    """
    pairs = _pairs(model) if isinstance(model, PlatformModel) else None
    if not isinstance(model, PlatformModel) or pairs is None:
        raise MethodError(
            "the method 'multi-loop' needs a pivoted plate with two points, two legs at each"
        )
    likely = likelihood.identify(model, space, observed)
    coordinates = likely.coordinates
    if likely.status is Status.DOES_NOT_CLOSE:
        return _did_not_close(space, coordinates)
    begin, start = likely.parameters, likely.values
    rotation, _ = model.plate_pose(coordinates)
    points = np.stack([begin[model.plate[pair[0]]] for pair in pairs])
    near = points @ np.swapaxes(rotation, 1, 2)
    _, usable = residual(model, observed.counts, begin, space.expansion, near)
    kept = np.flatnonzero(usable)
    if len(kept) < len(start):
        return _did_not_close(space, coordinates)

    def trial(z: Array) -> tuple[Closure, NDArray[np.bool_]]:
        return residual(model, observed.counts[kept], space.expand(z), space.expansion, near[kept])

    def evaluate(z: Array) -> Closure | None:
        closure, exists = trial(z)
        return closure if exists.all() else None

    while True:
        solved = solve(evaluate, start)
        if solved is None:
            return _did_not_close(space, coordinates)
        z, closure, status, iterations = solved
        if status is not Status.NO_PROGRESS:
            break
        # A pose at the edge of existence blocks the step: leave it out and go on from here.
        _, exists = trial(z + gauss_newton_step(closure))
        if exists.all() or exists.sum() < 2 * len(start):
            break
        kept, start = kept[exists], z
    sigma = observed.sigma[kept]
    return Estimate(
        method=NAME,
        space=space,
        status=status,
        iterations=iterations,
        parameters=space.expand(z),
        covariance=propagate(closure, sigma),
        jacobian=closure.jacobian,
        residual=closure.residual.ravel(),
        coordinates=coordinates,
        left_out=len(observed.counts) - len(kept),
        freedoms=len(kept) - len(z),
        misfit=closure.cost / expected_cost(closure, sigma),
        held=np.zeros((len(z), 0)),
    )


def _did_not_close(space: ParameterSpace, coordinates: Array) -> Estimate:
    n = len(space.names)
    return Estimate(
        method=NAME,
        space=space,
        status=Status.DOES_NOT_CLOSE,
        iterations=0,
        parameters=space.nominal,
        covariance=np.full((n, n), np.nan),
        jacobian=np.zeros((0, n)),
        residual=np.zeros(0),
        coordinates=coordinates,
        freedoms=0,
        misfit=float("nan"),
        held=np.zeros((n, 0)),
    )
