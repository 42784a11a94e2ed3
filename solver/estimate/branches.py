"""The ways in which a serial loop can be assembled over given readings, each followed from pose to pose.

A sensed loop closes in several ways at the same readings: a wrist flipped over, an elbow on
the other side. A mechanism in use stays in one of them. An assembly of all poses is found in
one pose, the nearest to home, by search around the circle, and then handed from neighbour to
neighbour in reading space, along the tree of shortest steps, so that all poses are on one
branch. Chosen for each pose by itself, poses would mix branches wherever the parameters are
not yet good enough to tell them apart.

Sensed coordinates are taken as measured, the unsensed ones as those of least closure error.
Which assembly is the right one is not decided here.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from solver.estimate.nuisance import Observations
from solver.mechanism.serial import SerialModel

Array = NDArray[np.float64]

_AT_REST = 1e-6  # rad or m
_ROUNDING = 1e-12
_AROUND = 160  # starts in the first pose
_MOST = 6  # assemblies that are worth following
_APART = 0.05  # rad or m between assemblies of one pose that are different ones
_STEP = 0.15  # rad or m between readings on the way from pose to pose
_MOST_STEPS = 8
_ON_THE_WAY = 4  # Gauss-Newton steps after each: the branch is kept, the rest can wait


def assemblies(model: SerialModel, observed: Observations, parameters: Array) -> Array:
    """Coordinates (A, P, U) of P poses in A assemblies, the one nearest to closing first.

    Poses of different fixtures are different loops, and are followed separately.
    """
    poses = len(observed.counts)
    fixture = None if observed.at is None else observed.at.fixture
    fixture = np.zeros(poses, dtype=np.intp) if fixture is None else fixture
    found = []
    for held in np.unique(fixture):
        rows = np.flatnonzero(fixture == held)
        found.append((rows, _of_one_loop(model, observed.take(rows), parameters)))
    out = np.empty((max(len(u) for _, u in found), poses, len(model.coordinate_names)))
    for rows, u in found:
        out[:, rows] = u[np.minimum(np.arange(len(out)), len(u) - 1)]
    return out


def nearest_closing(
    model: SerialModel,
    observed: Observations,
    parameters: Array,
    u: Array,
    *,
    iterations: int = 20,
) -> Array:
    """``u`` (P, U) with the unsensed coordinates moved to where the closure error is least."""
    u, unsensed = u.copy(), model.unsensed
    nowhere = np.zeros((len(parameters), 0))
    for _ in range(iterations if len(unsensed) else 0):
        at = model.linearise(u, parameters, nowhere, observed.at)
        step = least_squares(at.closure_by_coordinates[:, :, unsensed], -at.closure[:, :, None])
        u[:, unsensed] += np.clip(step[:, :, 0], -0.5, 0.5)
        if np.abs(step).max() < _AT_REST:
            break
    return u


def closure_error(model: SerialModel, observed: Observations, parameters: Array, u: Array) -> Array:
    """(P,) sums of squares of the closure at ``u`` (P, U), m and rad side by side."""
    at = model.linearise(u, parameters, np.zeros((len(parameters), 0)), observed.at)
    return np.asarray(np.sum(at.closure**2, axis=1))


def least_squares(matrix: Array, right: Array) -> Array:
    """(P, k, m) that minimise |matrix x - right|, of (P, K, k) and (P, K, m), k small."""
    transposed = np.swapaxes(matrix, 1, 2)
    normal = transposed @ matrix
    diagonal = np.arange(normal.shape[1])
    # A coordinate that moves nothing stays where it is.
    normal[:, diagonal, diagonal] += _ROUNDING * (1.0 + normal[:, diagonal, diagonal])
    return np.asarray(np.linalg.solve(normal, transposed @ right))


def _of_one_loop(model: SerialModel, observed: Observations, parameters: Array) -> Array:
    """`assemblies` of poses in one fixture."""
    u = np.tile(model.homes, (len(observed.counts), 1))
    u[:, model.sensed] = model.sensing.values(observed.counts, parameters)
    read = u[:, model.sensed]
    root = int(np.argmin(np.linalg.norm(read - model.homes[model.sensed], axis=1)))
    first = _around(model, observed.take(np.array([root])), parameters, u[root])
    followed = np.tile(u, (len(first), 1, 1))
    followed[:, root] = first
    for parents, children in _generations(read, root):
        some = observed.take(np.tile(children, len(first)))
        at = followed[:, parents]
        way = read[children] - read[parents]
        longest = float(np.linalg.norm(way, axis=1).max())
        steps = int(np.clip(np.ceil(longest / _STEP), 1, _MOST_STEPS))
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            at[:, :, model.sensed] = read[parents] + share * way
            flat = at.reshape(-1, at.shape[2])
            moved = nearest_closing(model, some, parameters, flat, iterations=_ON_THE_WAY)
            at = moved.reshape(at.shape)
        followed[:, children] = at
    every = observed.take(np.tile(np.arange(len(u)), len(first)))
    left = closure_error(model, every, parameters, followed.reshape(-1, u.shape[1]))
    return np.asarray(followed[np.argsort(left.reshape(len(first), -1).sum(axis=1), kind="stable")])


def _around(model: SerialModel, observed: Observations, parameters: Array, pose: Array) -> Array:
    """(A, U) assemblies of one pose, of ``pose`` (U,) with its unsensed turns anywhere."""
    turning = [
        j
        for j in model.unsensed
        if any(m.kind == "turn" and m.coordinate == j for m in model.chain.motions)
    ]
    starts = np.tile(pose, (_AROUND if turning else 1, 1))
    drawn = np.random.default_rng(0).uniform(-np.pi, np.pi, (len(starts) - 1, len(turning)))
    starts[1:, turning] += drawn
    many = observed.take(np.zeros(len(starts), dtype=np.intp))
    found = nearest_closing(model, many, parameters, starts)
    left = closure_error(model, many, parameters, found)
    different: list[Array] = []
    for one in found[np.argsort(left, kind="stable")]:
        apart = [one - other for other in different]
        for change in apart:
            change[turning] -= 2 * np.pi * np.round(change[turning] / (2 * np.pi))
        if all(np.abs(change).max() > _APART for change in apart):
            different.append(one)
        if len(different) == _MOST:
            break
    return np.array(different)


def _generations(read: Array, root: int) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Parents and children on the shortest tree over readings (P, C), from ``root`` outwards (Prim)."""
    poses = len(read)
    parent = np.full(poses, root)
    age = np.zeros(poses, dtype=np.intp)
    nearest = np.linalg.norm(read - read[root], axis=1)
    left = np.ones(poses, dtype=bool)
    left[root] = False
    for _ in range(poses - 1):
        new = int(np.argmin(np.where(left, nearest, np.inf)))
        left[new] = False
        age[new] = age[parent[new]] + 1
        distance = np.linalg.norm(read - read[new], axis=1)
        closer = left & (distance < nearest)
        parent[closer], nearest[closer] = new, distance[closer]
    for generation in range(1, int(age.max(initial=0)) + 1):
        children = np.flatnonzero(age == generation)
        yield parent[children], children
