"""Where a driven loop can go: the region of drive readings that is reachable from home, safely.

With as many drives as the loop has freedoms, their readings fix the pose on one branch. The
region is found by continuation: a grid over the drives' readings is flooded from home, each
node closed from a neighbour. A node counts when every joint is inside its limits with a
margin, the other joints are held firmly (far from singular), and the branch did not jump.

From what is reachable a convex part is taken, so that the straight line between any two
stops, in any order, stays reachable.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from recordings.rig import Rig, parameters
from solver.errors import MechanismError
from solver.mechanism.model import Model
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import assembled, limits, wander

Array = NDArray[np.float64]

STEP = 0.07  # rad or m between nodes
_MARGIN = 0.05  # rad or m inside every limit
_FIRM = 0.08  # smallest over largest singular value of what holds the other joints
_JUMP = 8.0  # steps that a joint may move between neighbours
_CLOSED = 1e-9
_MOST_NODES = 6000
_MOST_DRIVES = 3
_SAMPLED = 60
_CORNER_TRIES = 300
_TRUTHS = 8  # random mechanisms that must reach a node too,
_WRONG = 1.5  # each parameter off by this many stated uncertainties, times a normal draw


@dataclass(frozen=True)
class Region:
    """A convex region of drive readings.

    Attributes:
        drives: (k,) indices of the driven coordinates.
        coordinates: (G, U) closed configurations on a grid inside it, home first.
    """

    drives: tuple[int, ...]
    coordinates: Array


def drive_choices(rig: Rig, model: Model, x: Array) -> list[tuple[int, ...]]:
    """Sets of drives that fix the pose, the one that moves the other joints most first.

    With N the loop's freedoms (U, k), the others move by N_others N_drives^-1 for a unit of
    the drives. Sets that hold the others weakly somewhere in the workspace come last.

    Raises:
        MechanismError: the loop has no freedom, too many, or too few joints to drive.
    """
    poses = wander(rig, model, x, _SAMPLED, seed=0)
    mobility = model.mobility(poses, x)
    if not 1 <= mobility <= _MOST_DRIVES:
        raise MechanismError(
            f"the mechanism of rig '{rig.name}' has mobility {mobility}; drives are planned for 1 to {_MOST_DRIVES}. "
            'Use mode = "by-hand", or free less.'
        )
    driven = [device.joint for device in rig.devices if device.joint is not None]
    able = [
        model.coordinate_names.index(channel.senses)
        for channel in rig.channels
        if not driven or channel.senses in driven
    ]
    if len(able) < mobility:
        raise MechanismError(
            f"rig '{rig.name}' has mobility {mobility} but only {len(able)} sensed joints with a drive"
        )
    rates = _rates(model, poses, x)
    freedoms = np.swapaxes(np.linalg.svd(rates)[2][:, -mobility:], 1, 2)
    scored = []
    for drives in combinations(able, mobility):
        others = np.delete(freedoms, drives, axis=1)
        inverse = np.linalg.pinv(freedoms[:, drives], rcond=1e-9)
        motion = float(np.median(np.linalg.norm(others @ inverse, axis=(1, 2))))
        weak = float(np.quantile(_firmness(rates, drives), 0.25)) < _FIRM
        scored.append((weak, -motion, drives))
    return [drives for _, _, drives in sorted(scored)]


def _rates(model: Model, u: Array, x: Array) -> Array:
    """(P, K, U) closure rates with lengths in units of the mechanism's size."""
    at = model.linearise(u, x, np.zeros((len(x), 0)))
    rates = at.closure_by_coordinates
    size = float(np.median(np.linalg.norm(rates[:, :3], axis=(1, 2))))
    scale = np.ones(rates.shape[1])
    scale[:3] = 1.0 / max(size, 1e-9)
    return rates * scale[:, None]


def _firmness(rates: Array, drives: tuple[int, ...]) -> Array:
    singular = np.linalg.svd(np.delete(rates, drives, axis=2), compute_uv=False)
    return np.asarray(singular[:, -1] / np.maximum(singular[:, 0], 1e-300))


def close_holding(
    model: Model, coordinates: Array, x: Array, held: tuple[int, ...]
) -> tuple[Array, NDArray[np.bool_]]:
    """Closed configurations near ``coordinates`` (P, U) with the ``held`` ones unmoved, and which closed."""
    u = coordinates.copy()
    free = np.setdiff1d(np.arange(u.shape[1]), held)
    nowhere = np.zeros((len(x), 0))
    for _ in range(10):
        at = model.linearise(u, x, nowhere)
        if np.abs(at.closure).max(initial=0.0) < 1e-3 * _CLOSED:
            break
        inverse = np.linalg.pinv(at.closure_by_coordinates[:, :, free], rcond=1e-9)
        step = -(inverse @ at.closure[:, :, None])[:, :, 0]
        u[:, free] += np.clip(step, -0.3, 0.3)
    error = np.abs(model.linearise(u, x, nowhere).closure).max(axis=1, initial=0.0)
    return u, error < _CLOSED


def reachable(rig: Rig, model: Model, x: Array, drives: tuple[int, ...]) -> Region:
    """The convex region around home that ``drives`` can reach on home's branch.

    Raises:
        MechanismError: not even the neighbourhood of home is safe.
    """
    home = assembled(rig, model, x)
    nodes, coordinates = _flooded(rig, model, x, drives, home)
    sure = _robust(rig, model, x, drives, coordinates)
    nodes, coordinates = nodes[sure], coordinates[sure]
    inside = _convex_part(nodes) if sure[0] else np.zeros(0, dtype=np.intp)
    if len(inside) < 3:
        held = ", ".join(model.coordinate_names[d] for d in drives)
        raise MechanismError(
            f"driving {held}, nothing around the home of rig '{rig.name}' can be reached safely: home is near a joint "
            "limit or a singular configuration. Choose another home."
        )
    return Region(drives, coordinates[inside])


def _flooded(
    rig: Rig, model: Model, x: Array, drives: tuple[int, ...], home: Array
) -> tuple[NDArray[np.int64], Array]:
    """Nodes (G, k) of the grid, home's first, and closed configurations there (G, U)."""
    low, high = limits(rig, model)
    low = np.maximum(low + _MARGIN, home - np.pi)
    high = np.minimum(high - _MARGIN, home + np.pi)
    count = len(drives)
    moves = np.vstack([np.eye(count, dtype=np.int64), -np.eye(count, dtype=np.int64)])
    nodes, found = [np.zeros(count, dtype=np.int64)], [home]
    seen = {tuple(nodes[0])}
    front = [0]
    while front and len(nodes) < _MOST_NODES:
        parents, ahead = [], []
        for i in front:
            for move in moves:
                node = nodes[i] + move
                if tuple(node) not in seen:
                    seen.add(tuple(node))
                    parents.append(i)
                    ahead.append(node)
        if not ahead:
            break
        start = np.array([found[i] for i in parents])
        before = start.copy()
        start[:, drives] = home[list(drives)] + STEP * np.array(ahead)
        u, closed = close_holding(model, start, x, drives)
        good = closed & ((u >= low) & (u <= high)).all(axis=1)
        good &= np.abs(u - before).max(axis=1) < _JUMP * STEP
        good &= _firmness(_rates(model, u, x), drives) > _FIRM
        front = []
        for j in np.flatnonzero(good):
            front.append(len(nodes))
            nodes.append(ahead[j])
            found.append(u[j])
    return np.array(nodes), np.array(found)


def _robust(
    rig: Rig, model: Model, x: Array, drives: tuple[int, ...], coordinates: Array
) -> NDArray[np.bool_]:
    """Which configurations (G, U) stay within reach when the true parameters differ as stated."""
    space = ParameterSpace.of(parameters(rig))
    spread = np.where(np.isfinite(space.uncertainty), space.uncertainty, 0.0)
    low, high = limits(rig, model)
    sure = np.ones(len(coordinates), dtype=bool)
    rng = np.random.default_rng(0)
    for _ in range(_TRUTHS):
        truth = x + space.expansion @ (_WRONG * spread * rng.standard_normal(len(spread)))
        u, closed = close_holding(model, coordinates, truth, drives)
        sure &= closed & ((u >= low) & (u <= high)).all(axis=1)
    return sure


def _convex_part(nodes: NDArray[np.int64]) -> NDArray[np.intp]:
    """Indices of the nodes in a large convex region with the first, home, that holds no hole.

    Home may lie on its edge: a session starts there, whatever the true mechanism is.
    """
    present = {tuple(node) for node in nodes}
    # One step from the edge is kept: the true mechanism differs from the nominal one.
    around = np.array(np.meshgrid(*[[-1, 0, 1]] * nodes.shape[1])).reshape(nodes.shape[1], -1).T
    core = np.array([all(tuple(node + move) in present for move in around) for node in nodes])
    kept = {tuple(node) for node in nodes[core]} | {tuple(nodes[0])}
    if nodes.shape[1] == 1:
        low = high = 0
        while (low - 1,) in kept:
            low -= 1
        while (high + 1,) in kept:
            high += 1
        return np.flatnonzero((nodes[:, 0] >= low) & (nodes[:, 0] <= high))
    best: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
    span = nodes.min(axis=0), nodes.max(axis=0)
    box = np.stack(
        np.meshgrid(*[np.arange(a, b + 1) for a, b in zip(*span, strict=True)], indexing="ij"), -1
    ).reshape(-1, nodes.shape[1])
    missing = np.array([node for node in box if tuple(node) not in kept])
    begin = _beginning(nodes, core, kept, around, missing)
    if begin is None:
        return best
    for seed in range(4):
        rng = np.random.default_rng(seed)
        corners: Array = begin.astype(np.float64)
        tries = nodes[core][rng.permutation(int(core.sum()))[:_CORNER_TRIES]]
        for node in tries:
            hull = ConvexHull(np.vstack([corners, node]))
            if not len(missing) or not _within(hull, missing).any():
                corners = hull.points[hull.vertices]
        inside = np.flatnonzero(_within(ConvexHull(corners), nodes))
        if len(inside) > len(best):
            best = inside
    return best


def _beginning(
    nodes: NDArray[np.int64],
    core: NDArray[np.bool_],
    kept: set[tuple[int, ...]],
    around: NDArray[np.int64],
    missing: NDArray[np.int64],
) -> NDArray[np.int64] | None:
    """Corners of a small convex region without a hole: home, and what is kept around it or near it."""
    near = np.flatnonzero(core)
    for centre in nodes[near[np.argsort(np.linalg.norm(nodes[near], axis=1), kind="stable")]]:
        block = [tuple(node) for node in centre + around if tuple(node) in kept]
        corners = np.array([*block, tuple(nodes[0])])
        if np.linalg.matrix_rank(corners - corners[-1]) < nodes.shape[1]:
            continue
        if not len(missing) or not _within(ConvexHull(corners), missing).any():
            return corners
    return None


def _within(hull: ConvexHull, points: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(
        (points @ hull.equations[:, :-1].T + hull.equations[:, -1] <= 1e-9).all(axis=1)
    )
