"""The true coordinates of each pose, eliminated: the closed configuration nearest to its readings.

For given parameters x, pose i has the coordinates u_i that minimise |W_i (y_i - h(u, x))|^2
subject to c(u, x) = 0, with W the inverse standard deviations of the readings. Each pose is a
small equality-constrained least-squares problem, solved by Gauss-Newton on its KKT system

    [ H'H  A' ] [ du     ]   [ H'r ]        H = W dh/du,  r = W (y - h)
    [ A    0  ] [ lambda ] = [ -c  ]        A = dc/du

for all poses at once. The same matrix gives du/dx, and with it the derivative of the
eliminated residual: the profile likelihood's exact gradient and Gauss-Newton matrix
(errors-in-variables; Fuller, "Measurement Error Models", 1987, section 3.2).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import Linearised, Model

Array = NDArray[np.float64]

TOGETHER = 2048
"""Poses worked on at once: larger arrays leave the processor's cache, and memory grows with them."""

_LARGEST_STEP = 0.5  # rad or m a Gauss-Newton step may move a coordinate
_OUTLYING = 30.0  # a pose this many times worse than the median may sit on another branch
_ASTRAY = 1000.0  # the same where the start has followed the branch: 20 standard deviations
_NEIGHBOURS = 3  # whose assembly such a pose tries
_HANDED_ON = 5  # times that an assembly is handed from neighbour to neighbour
_WORTHLESS = 1e-4  # of the best-known coordinate's weight
_REGULARISED = (
    1e-11  # keeps the KKT matrix of a singular pose invertible; far below any information
)


@dataclass(frozen=True, slots=True)
class Observations:
    """What was measured: P poses, C channels.

    Attributes:
        counts: (P, C) [counts], averaged readings.
        sigma: (P, C) [counts], their standard deviations.
        at: (P,) under what circumstances they were measured; None where it does not matter.
    """

    counts: Array
    sigma: Array
    at: Circumstances | None = None

    def take(self, poses: NDArray[np.intp]) -> Observations:
        """The observations of some poses."""
        at = None if self.at is None else self.at.take(poses)
        return Observations(self.counts[poses], self.sigma[poses], at)


@dataclass(frozen=True, slots=True)
class Settled:
    """Poses at their most likely closed configuration.

    Attributes:
        coordinates: (P, U) [rad or m].
        residual: (P, C), whitened measured - predicted.
        jacobian: (P, C, n), its derivative with the reduced parameters, coordinates following.
        following: (P, U, n), derivative of the coordinates with the reduced parameters.
        at_rest: (P,), whether the search came to rest; when not, the coordinates close the loop
            but others would fit the readings better.
        closed: (P,), whether the pose's loop closes.
        closure_m_rad: (P,), largest closure error left.
    """

    coordinates: Array
    residual: Array
    jacobian: Array
    following: Array
    at_rest: NDArray[np.bool_]
    closed: NDArray[np.bool_]
    closure_m_rad: Array

    @property
    def cost(self) -> float:
        """Sum of squared whitened residuals."""
        return float(np.sum(self.residual**2))


def settle(
    model: Model,
    observed: Observations,
    coordinates: Array,
    parameters: Array,
    expansion: Array,
    *,
    iterations: int = 40,
    tolerance: float = 1e-4,
) -> Settled:
    """Most likely closed configurations near ``coordinates``.

    Args:
        model: the mechanism.
        observed: P poses.
        coordinates: (P, U) start.
        parameters: (N,) full parameter vector.
        expansion: (N, n) from reduced to full parameter changes.
        iterations: Gauss-Newton steps at most.
        tolerance: a pose is at rest when its step is below this fraction of one standard
            deviation plus its largest residual.
    """
    poses = len(coordinates)
    parts = [
        _settle(
            model,
            observed.take(rows),
            coordinates[rows],
            parameters,
            expansion,
            iterations,
            tolerance,
        )
        for rows in np.split(np.arange(poses), range(TOGETHER, poses, TOGETHER))
    ]
    if len(parts) == 1:
        return parts[0]
    return Settled(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Settled))
    )


def _settle(
    model: Model,
    observed: Observations,
    coordinates: Array,
    parameters: Array,
    expansion: Array,
    iterations: int,
    tolerance: float,
) -> Settled:
    u = coordinates.copy()
    nowhere = expansion[:, :0]
    poses, size = u.shape
    damping = np.zeros(poses)
    moved = np.full(poses, np.inf)
    at_rest = np.zeros(poses, dtype=bool)
    moving = np.arange(poses)
    for _ in range(iterations):
        here = observed.take(moving)
        at = model.linearise(u[moving], parameters, nowhere, here.at)
        kkt, target, scale = _kkt(at, here)
        misread = np.abs((here.counts - at.readings) / here.sigma).max(axis=1)
        sensed = np.arange(size)
        kkt[:, sensed, sensed] += damping[moving, None] * kkt[:, sensed, sensed]
        step = np.linalg.solve(kkt, target[:, :, None])[:, :size, 0]
        length = np.abs(step).max(axis=1) * (1.0 + damping[moving])
        # Far from its readings a pose overshoots, or circles: damp it until its steps shrink.
        shrinking = length < 0.9 * moved[moving]
        damping[moving] = np.where(shrinking, 0.3 * damping[moving], 2.0 * damping[moving] + 0.3)
        damping[moving[moved[moving] == np.inf]] = 0.0
        moved[moving] = length
        step *= scale
        largest = np.abs(step).max(axis=1, keepdims=True)
        u[moving] += step * np.minimum(1.0, _LARGEST_STEP / np.maximum(largest, 1e-300))
        resting = length < tolerance * (1.0 + misread)
        at_rest[moving] = resting
        moving = moving[~resting]
        if not len(moving):
            break
    if len(moving):
        u[moving] = _closed(model, observed.take(moving), u[moving], parameters, nowhere)
    return _settled(model.linearise(u, parameters, expansion, observed.at), observed, u, at_rest)


def _closed(
    model: Model, observed: Observations, u: Array, parameters: Array, nowhere: Array
) -> Array:
    """``u`` moved as little as possible onto the closure."""
    for _ in range(4):
        kkt, target, scale = _kkt(model.linearise(u, parameters, nowhere, observed.at), observed)
        size = u.shape[1]
        target[:, :size] = 0.0
        u = u + np.linalg.solve(kkt, target[:, :, None])[:, :size, 0] * scale
    return u


def _kkt(at: Linearised, observed: Observations) -> tuple[Array, Array, Array]:
    """KKT matrices (P, U+K, U+K), right-hand sides (P, U+K), and coordinate scales (P, U)."""
    weighted = at.readings_by_coordinates / observed.sigma[:, :, None]
    residual = (observed.counts - at.readings) / observed.sigma
    norms = np.linalg.norm(weighted, axis=1)
    # Nothing is scaled up more than so much: a reading that is worth nothing must not rule the closure.
    largest = norms.max(axis=1, keepdims=True)
    norms = np.where(norms > 0, np.maximum(norms, _WORTHLESS * largest), 0.0)
    floor = np.where(norms > 0, norms, np.inf).min(axis=1, keepdims=True)
    scale = 1.0 / np.where(norms > 0, norms, floor)
    H = weighted * scale[:, None, :]
    A, rows = _scaled_closure(at, scale)
    size, closures = H.shape[2], A.shape[1]
    kkt = np.zeros((len(H), size + closures, size + closures))
    transposed = np.swapaxes(H, 1, 2)
    kkt[:, :size, :size] = transposed @ H
    kkt[:, size:, :size] = A
    kkt[:, :size, size:] = np.swapaxes(A, 1, 2)
    diagonal = np.arange(size + closures)
    kkt[:, diagonal, diagonal] += np.where(diagonal < size, _REGULARISED, -_REGULARISED)
    target = np.concatenate(
        [(transposed @ residual[:, :, None])[:, :, 0], -at.closure * rows], axis=1
    )
    return kkt, target, scale


def _scaled_closure(at: Linearised, scale: Array) -> tuple[Array, Array]:
    """Closure rows scaled to unit norm, (P, K, U), and the factors (P, K)."""
    A = at.closure_by_coordinates * scale[:, None, :]
    rows = 1.0 / np.maximum(np.linalg.norm(A, axis=2), 1e-300)
    return A * rows[:, :, None], rows


def _settled(
    at: Linearised, observed: Observations, u: Array, at_rest: NDArray[np.bool_]
) -> Settled:
    jacobian, following = eliminated(
        at, observed, at.readings_by_parameters, at.closure_by_parameters
    )
    error = np.abs(at.closure).max(axis=1, initial=0.0)
    return Settled(
        coordinates=u,
        residual=(observed.counts - at.readings) / observed.sigma,
        jacobian=jacobian,
        following=following,
        at_rest=at_rest,
        closed=error < 1e-8,
        closure_m_rad=error,
    )


def eliminated(
    at: Linearised, observed: Observations, by_readings: Array, by_closure: Array
) -> tuple[Array, Array]:
    """What changes of the model do to settled poses, whose coordinates follow.

    Args:
        at: the model at the settled poses.
        observed: P poses.
        by_readings: (P, C, m) change of predicted readings [counts] along m directions.
        by_closure: (P, K, m) change of the closure.

    Returns:
        (P, C, m) change of the whitened residual, and (P, U, m) of the coordinates.
    """
    kkt, _, scale = _kkt(at, observed)
    H = at.readings_by_coordinates / observed.sigma[:, :, None]
    Hx = by_readings / observed.sigma[:, :, None]
    _, rows = _scaled_closure(at, scale)
    pull = np.concatenate(
        [-np.swapaxes(H * scale[:, None, :], 1, 2) @ Hx, -by_closure * rows[:, :, None]], axis=1
    )
    following = np.linalg.solve(kkt, pull)[:, : H.shape[2]] * scale[:, :, None]
    return -Hx - H @ following, following


def assemble(model: Model, observed: Observations, parameters: Array) -> Array:
    """Starting coordinates (P, U) for every pose, from the model's own starts.

    Each pose takes the start that is nearest to closing, or where nothing has to close the
    model's first; a pose that does not settle from there, or settles far worse than the others
    do, tries the next. Without closure the first start has followed its branch from the
    neutral pose, and at wrong parameters some pose always fits badly: only one that fits worse
    than that could explain may leave its branch, because there is little to tell it from others.
    """
    nowhere = np.zeros((len(parameters), 0))
    starts = model.starts(observed.counts, parameters)
    scores = np.empty(starts.shape[:2])
    for s, start in enumerate(starts):
        at = model.linearise(start, parameters, nowhere, observed.at)
        closes = at.closure.shape[1] > 0
        scores[s] = np.sum(at.closure**2, axis=1) if closes else s
    outlying = _OUTLYING if closes else _ASTRAY
    order = np.argsort(scores, axis=0)
    every = np.arange(starts.shape[1])
    best: Array = starts[order[0], every]
    cost = np.full(len(every), np.inf)
    todo = every
    for choice in order:
        found = settle(model, observed.take(todo), starts[choice[todo], todo], parameters, nowhere)
        now = np.where(found.closed, np.sum(found.residual**2, axis=1), np.inf)
        better = now < cost[todo]
        best[todo[better]] = found.coordinates[better]
        cost[todo[better]] = now[better]
        usual = np.median(cost)
        todo = np.flatnonzero(~(cost <= outlying * max(usual, 1.0)))
        if not len(todo):
            break
    return _from_neighbours(model, observed, parameters, best, cost, outlying)


def _from_neighbours(
    model: Model,
    observed: Observations,
    parameters: Array,
    coordinates: Array,
    cost: Array,
    outlying: float,
) -> Array:
    """``coordinates`` (P, U) with the poses that settled badly restarted from poses that read nearly alike.

    Poses that settled well hand their assembly on to their neighbours in reading space, and
    those to theirs, for as long as it helps.
    """
    nowhere = np.zeros((len(parameters), 0))
    u, cost = coordinates.copy(), cost.copy()
    spread = observed.counts.std(axis=0) + observed.sigma.mean(axis=0)
    where = observed.counts / spread
    for _ in range(_HANDED_ON):
        badly = ~(cost <= outlying * max(float(np.median(cost)), 1.0))
        todo, well = np.flatnonzero(badly), np.flatnonzero(~badly)
        if not len(todo) or not len(well):
            break
        apart = np.linalg.norm(where[todo, None] - where[well], axis=2)
        helped = False
        for rank in range(min(_NEIGHBOURS, len(well))):
            nearest = well[np.argsort(apart, axis=1)[:, rank]]
            found = settle(model, observed.take(todo), u[nearest], parameters, nowhere)
            now = np.where(found.closed, np.sum(found.residual**2, axis=1), np.inf)
            better = now < 0.99 * cost[todo]
            u[todo[better]], cost[todo[better]] = found.coordinates[better], now[better]
            helped = helped or bool(better.any())
        if not helped:
            break
    return u
