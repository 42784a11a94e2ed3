"""A first approach to serial loops: parameters that make the measured readings close, noise ignored.

Takes the sensed coordinates as measured, eliminates the unsensed ones by least squares, and
minimises the closure errors (m and rad side by side) by the trust region. From a poor start
this comes near the answer at little cost, where the likelihood's search for each pose's
true coordinates would creep; the likelihood then takes over.

One unsensed coordinate is placed in each pose by itself; several are followed from pose to pose
in each of the assemblies that the loop has (`branches`), the one nearest to closing first.
Where the loops stay open, or close only far from what the rig says, the search goes on in
other assemblies and from starts near the given one. Far from it lie exact twins: a wrist whose
middle joint is unsensed reads the same when flipped over, with its neighbours half a turn off.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.branches import assemblies, closure_error, least_squares, nearest_closing
from solver.estimate.identifiability import plausible_error
from solver.estimate.nuisance import TOGETHER, Observations
from solver.estimate.null_directions import common_scale
from solver.estimate.trust_region import Evaluation, Minimum, minimise
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_SIZE_KEPT = (
    10.0  # m of closure error that halving the mechanism would have to remove: it never does
)
_CLOSES_TO = 1e-3  # rad or m: closure error that weighs as much as one prior standard deviation
_HARDLY = 1e-5  # rad or m: the same for a plausible error where no prior is asked for
_CLOSES_WELL = 0.02  # rad or m: anything worse is a false minimum, and worth another start
_RESTARTS = 6
_SHAKE = 0.3  # of what parameters may plausibly be wrong
_MOST = 4  # assemblies searched in from the start,
_MOST_SHAKEN = 2  # and from each shaken one
_FAR = 3.0  # plausible errors from nominal, where an uncertainty is stated: a twin, not the answer


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
    # What no pose shows stays where it is instead of wandering with rounding errors.
    weight = _HARDLY / plausible_error(space)
    weight[believed] = _CLOSES_TO / width[believed]
    pull = np.diag(weight)
    scale = common_scale(space, start)
    if scale is not None:
        pull = np.vstack([pull, _SIZE_KEPT * scale / (scale @ scale)])

    def searched(begin: Array, nearby: Array) -> Minimum[_Closed] | None:
        """The minimum near reduced parameters ``begin``, coordinates near ``nearby`` (P, U)."""

        def evaluate(z: Array, state: _Closed | None) -> Evaluation[_Closed]:
            parameters = space.expand(z, start)
            u = nearby.copy()
            if state is not None:
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

        return minimise(evaluate, begin, tolerance=1e-6, floor=1e-14)

    best: Minimum[_Closed] | None = None
    for begin, nearby in _beginnings(model, space, observed, start):
        found = searched(begin, nearby)
        if found is None:
            continue
        if best is None or _rank(model, space, found) < _rank(model, space, best):
            best = found
        if _rank(model, space, best) == (False, 0.0):
            break
    if best is None:
        return start, _placed(model, everything, start)
    variables = best.variables - _whole_turns(model, space, best.variables)
    parameters = space.expand(variables, start)
    if poses > TOGETHER or not np.array_equal(variables, best.variables):
        return parameters, _placed(model, everything, parameters)
    return parameters, best.last.state.coordinates


def _beginnings(
    model: SerialModel, space: ParameterSpace, observed: Observations, start: Array
) -> Iterator[tuple[Array, Array]]:
    """Reduced parameters (n,) and coordinates (P, U) to search from, the likeliest first."""
    begin = space.reduce(start)
    several = len(model.unsensed) > 1
    if not several:
        yield begin, _nearest_start(model, observed, start)
    for u in assemblies(model, observed, start)[: _MOST if several else 0]:
        yield begin, u
    rng = np.random.default_rng(0)
    for _ in range(_RESTARTS):
        shaken = begin + _SHAKE * plausible_error(space) * rng.standard_normal(len(begin))
        parameters = space.expand(shaken, start)
        if not several:
            yield shaken, _nearest_start(model, observed, parameters)
            continue
        for u in assemblies(model, observed, parameters)[:_MOST_SHAKEN]:
            yield shaken, u


def _rank(
    model: SerialModel, space: ParameterSpace, minimum: Minimum[_Closed]
) -> tuple[bool, float]:
    """Whether it lies implausibly far from what the rig says, and how badly it closes: 0 where well."""
    size = _size(minimum)
    if size >= _CLOSES_WELL:
        return True, size
    z = minimum.variables - _whole_turns(model, space, minimum.variables)
    stated = np.isfinite(space.uncertainty)
    away = np.abs(z - space.reduce(space.nominal))[stated]
    return bool((away > _FAR * plausible_error(space)[stated]).any()), 0.0


def _size(minimum: Minimum[_Closed]) -> float:
    """Root mean square of what is left."""
    return float(np.sqrt(np.mean(minimum.last.residual**2)))


def _whole_turns(model: SerialModel, space: ParameterSpace, variables: Array) -> Array:
    """(n,) whole turns by which identified angles of the chain have wandered from nominal."""
    angles = {m.parameter for m in model.chain.motions if m.kind == "turn"}
    wandering = np.isin(space.identified, list(angles))
    turns = np.round((variables - space.reduce(space.nominal)) / (2 * np.pi))
    return np.where(wandering, 2 * np.pi * turns, 0.0)


def _placed(model: SerialModel, observed: Observations, parameters: Array) -> Array:
    """Coordinates (P, U) nearest to closing, unsensed ones by search, many poses in turn."""
    poses = len(observed.counts)
    parts = []
    for rows in np.split(np.arange(poses), range(TOGETHER, poses, TOGETHER)):
        some = observed.take(rows)
        if len(model.unsensed) > 1:
            near = assemblies(model, some, parameters)[0]
        else:
            near = _nearest_start(model, some, parameters)
        parts.append(nearest_closing(model, some, parameters, near))
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
    """(P, U) the model's start that is nearest to closing, for each pose by itself."""
    starts = model.starts(observed.counts, parameters)
    poses = len(observed.counts)
    many = observed.take(np.tile(np.arange(poses), len(starts)))
    left = closure_error(model, many, parameters, starts.reshape(-1, starts.shape[2]))
    nearest = np.argmin(left.reshape(starts.shape[:2]), axis=0)
    return np.asarray(starts[nearest, np.arange(poses)])


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
    u = nearest_closing(model, observed, parameters, u)
    at = model.linearise(u, parameters, space.expansion, observed.at)
    jacobian = at.closure_by_parameters + at.closure_by_coordinates[:, :, model.sensed] @ (
        model.sensing.by_parameters(observed.counts, space.expansion)
    )
    by_unsensed = at.closure_by_coordinates[:, :, unsensed]
    following = least_squares(by_unsensed, -jacobian)
    jacobian = jacobian + by_unsensed @ following
    return Evaluation(
        at.closure.ravel(),
        jacobian.reshape(-1, jacobian.shape[2]),
        _Closed(variables, u, following),
    )
