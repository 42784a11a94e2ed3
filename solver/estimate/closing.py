"""A first approach to serial loops: parameters that make the measured readings close, noise ignored.

Takes the sensed coordinates as measured, eliminates the unsensed ones by least squares, and
minimises the closure errors (m and rad side by side) by the trust region. From a poor start
this comes near the answer at little cost, where the likelihood's search for each pose's
true coordinates would creep; the likelihood then takes over. Where the loops stay open, the
search begins again from starts near the given one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.identifiability import plausible_error
from solver.estimate.nuisance import TOGETHER, Observations
from solver.estimate.null_directions import common_scale
from solver.estimate.trust_region import Evaluation, Minimum, minimise
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_INNER = 20
_TRIED = 8  # starts of a pose with several unsensed coordinates
_AT_REST = 1e-6  # rad or m
_SIZE_KEPT = (
    10.0  # m of closure error that halving the mechanism would have to remove: it never does
)
_CLOSES_TO = 1e-3  # rad or m: closure error that weighs as much as one prior standard deviation
_CLOSES_WELL = 0.02  # rad or m: anything worse is a false minimum, and worth another start
_RESTARTS = 6
_SHAKE = 0.3  # of what parameters may plausibly be wrong
_ROUNDING = 1e-12


def approach(
    model: SerialModel,
    space: ParameterSpace,
    observed: Observations,
    start: Array,
    *,
    use_priors: bool = False,
) -> tuple[Array, Array]:
    """Parameters (N,) and coordinates (P, U) near which the loops close.

    Args:
        model: the chain.
        space: what is identified.
        observed: averaged readings of P poses.
        start: (N,) full parameters to start from.
        use_priors: hold the parameters near their nominal values by the rig's stated
            uncertainties, so that what closure does not determine stays where it is.
    """
    everything = observed
    poses = len(observed.counts)
    if poses > TOGETHER:  # more poses than these do not bring the start nearer
        observed = observed.take(np.linspace(0, poses - 1, TOGETHER).astype(np.intp))
    counts = observed.counts
    mean, width = space.reduce(space.nominal), space.uncertainty
    believed = np.isfinite(width) if use_priors else np.zeros(len(width), dtype=bool)
    pull = _CLOSES_TO * np.eye(len(width))[believed] / width[believed, None]
    scale = common_scale(space, start)
    if scale is not None:
        pull = np.vstack([pull, _SIZE_KEPT * scale / (scale @ scale)])

    def evaluate(z: Array, state: _Closed | None) -> Evaluation[_Closed]:
        parameters = space.expand(z, start)
        if state is None:
            u = _nearest_start(model, observed, parameters)
        else:
            u = state.coordinates.copy()
            u[:, model.unsensed] += np.clip(state.following @ (z - state.variables), -0.5, 0.5)
        u[:, model.sensed] = model.sensing.values(counts, parameters)
        found = _evaluation(model, space, observed, z, parameters, u)
        distances, by_parameters = model.pseudo_observations(parameters, space.expansion)
        return Evaluation(
            np.concatenate([found.residual, _CLOSES_TO * distances, pull @ (z - mean)]),
            np.vstack([found.jacobian, _CLOSES_TO * by_parameters, pull]),
            found.state,
        )

    begin = space.reduce(start)
    best = minimise(evaluate, begin, tolerance=1e-6, floor=1e-14)
    rng = np.random.default_rng(0)
    for _ in range(_RESTARTS):
        if best is not None and _size(best) < _CLOSES_WELL:
            break
        shaken = begin + _SHAKE * plausible_error(space) * rng.standard_normal(len(begin))
        other = minimise(evaluate, shaken, tolerance=1e-6, floor=1e-14)
        if other is not None and (best is None or _size(other) < 0.5 * _size(best)):
            best = other
    if best is None:
        return start, _placed(model, everything, start)
    parameters = space.expand(best.variables, start)
    turns = _whole_turns(model, space, parameters)
    if poses > TOGETHER or turns.any():
        parameters = parameters - turns
        return parameters, _placed(model, everything, parameters)
    return parameters, best.last.state.coordinates


def _size(minimum: Minimum[_Closed]) -> float:
    """Root mean square of what is left."""
    return float(np.sqrt(np.mean(minimum.last.residual**2)))


def _whole_turns(model: SerialModel, space: ParameterSpace, parameters: Array) -> Array:
    """(N,) whole turns by which identified angles of the chain have wandered from nominal."""
    angles = {m.parameter for m in model.chain.motions if m.kind == "turn"}
    wandering = np.isin(space.identified, list(angles))
    difference = space.reduce(parameters - space.nominal)
    turns = 2 * np.pi * np.round(difference / (2 * np.pi))
    return np.asarray(space.expansion @ np.where(wandering, turns, 0.0))


def _placed(model: SerialModel, observed: Observations, parameters: Array) -> Array:
    """Coordinates (P, U) nearest to closing, unsensed ones by search, many poses in turn."""
    poses = len(observed.counts)
    parts = []
    for rows in np.split(np.arange(poses), range(TOGETHER, poses, TOGETHER)):
        some = observed.take(rows)
        parts.append(
            _nearest_closing(model, some, parameters, _nearest_start(model, some, parameters))
        )
    return np.concatenate(parts)


def placed(
    model: SerialModel, space: ParameterSpace, observed: Observations, start: Array
) -> Array:
    """``start`` (N,) with fixtures of unknown place where the readings, taken as they are, put them.

    Unknown is what is identified without a stated uncertainty.
    """
    held_at = set(model.fixture_parameters.tolist())
    unknown = [
        space.table[i].name
        for i in space.identified
        if int(i) in held_at and space.table[i].uncertainty is None
    ]
    if not unknown:
        return start
    return approach(model, ParameterSpace.of(space.table, unknown), observed, start)[0]


@dataclass(frozen=True, slots=True)
class _Closed:
    """Coordinates (P, U) at reduced parameters (n,), and how the unsensed ones follow them (P, k, n)."""

    variables: Array
    coordinates: Array
    following: Array


def _nearest_start(model: SerialModel, observed: Observations, parameters: Array) -> Array:
    starts = model.starts(observed.counts, parameters)
    nowhere = np.zeros((len(parameters), 0))
    at = model.linearise(
        starts.reshape(-1, starts.shape[2]),
        parameters,
        nowhere,
        None if observed.at is None else observed.at.repeated(len(starts)),
    )
    errors = np.sum(at.closure**2, axis=1).reshape(starts.shape[:2])
    order, every = np.argsort(errors, axis=0), np.arange(len(observed.counts))
    best: Array = starts[order[0], every]
    if len(model.unsensed) < 2:
        return best
    # Several unsensed coordinates: the start nearest to closing may lead to another assembly.
    least = np.full(len(every), np.inf)
    for choice in order[:_TRIED]:
        u = _nearest_closing(model, observed, parameters, starts[choice, every])
        closure = model.linearise(u, parameters, nowhere, observed.at).closure
        error = np.sum(closure**2, axis=1)
        better = error < 0.5 * least
        best[better], least[better] = u[better], error[better]
    return best


def _evaluation(
    model: SerialModel,
    space: ParameterSpace,
    observed: Observations,
    variables: Array,
    parameters: Array,
    u: Array,
) -> Evaluation[_Closed]:
    """Closure errors with the unsensed coordinates eliminated, and their derivative."""
    unsensed = model.unsensed
    u = _nearest_closing(model, observed, parameters, u)
    at = model.linearise(u, parameters, space.expansion, observed.at)
    jacobian = at.closure_by_parameters + at.closure_by_coordinates[:, :, model.sensed] @ (
        model.sensing.by_parameters(observed.counts, space.expansion)
    )
    by_unsensed = at.closure_by_coordinates[:, :, unsensed]
    following = _least_squares(by_unsensed, -jacobian)
    jacobian = jacobian + by_unsensed @ following
    return Evaluation(
        at.closure.ravel(),
        jacobian.reshape(-1, jacobian.shape[2]),
        _Closed(variables, u, following),
    )


def _nearest_closing(
    model: SerialModel, observed: Observations, parameters: Array, u: Array
) -> Array:
    """``u`` (P, U) with the unsensed coordinates moved to where the closure error is least."""
    u, unsensed = u.copy(), model.unsensed
    nowhere = np.zeros((len(parameters), 0))
    for _ in range(_INNER if len(unsensed) else 0):
        at = model.linearise(u, parameters, nowhere, observed.at)
        step = _least_squares(at.closure_by_coordinates[:, :, unsensed], -at.closure[:, :, None])
        u[:, unsensed] += np.clip(step[:, :, 0], -0.5, 0.5)
        if np.abs(step).max() < _AT_REST:
            break
    return u


def _least_squares(matrix: Array, right: Array) -> Array:
    """(P, k, m) that minimise |matrix x - right|, of (P, K, k) and (P, K, m), k small."""
    transposed = np.swapaxes(matrix, 1, 2)
    normal = transposed @ matrix
    diagonal = np.arange(normal.shape[1])
    # A coordinate that moves nothing stays where it is.
    normal[:, diagonal, diagonal] += _ROUNDING * (1.0 + normal[:, diagonal, diagonal])
    return np.asarray(np.linalg.solve(normal, transposed @ right))
