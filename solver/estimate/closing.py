"""A first approach to serial loops: parameters that make the measured readings close, noise ignored.

Takes the sensed coordinates as measured, eliminates the unsensed ones by least squares, and
minimises the closure errors (m and rad side by side) by the trust region. From a poor start
this comes near the answer at little cost, where the likelihood's search for each pose's
true coordinates would creep; the likelihood then takes over.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.estimate.nuisance import Observations
from solver.estimate.trust_region import Evaluation, minimise
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_INNER = 20
_AT_REST = 1e-7  # rad or m


def approach(
    model: SerialModel, space: ParameterSpace, observed: Observations, start: Array
) -> tuple[Array, Array]:
    """Parameters (N,) and coordinates (P, U) near which the loops close.

    Args:
        model: the chain.
        space: what is identified.
        observed: averaged readings of P poses.
        start: (N,) full parameters to start from.
    """
    counts = observed.counts

    def evaluate(z: Array, state: Array | None) -> Evaluation[Array]:
        parameters = space.expand(z, start)
        u = _nearest_start(model, counts, parameters) if state is None else state.copy()
        u[:, model.sensed] = model.sensing.values(counts, parameters)
        return _evaluation(model, space, counts, parameters, u)

    minimum = minimise(evaluate, space.reduce(start), tolerance=1e-6, floor=1e-14)
    if minimum is None:
        return start, _nearest_start(model, counts, start)
    return space.expand(minimum.variables, start), minimum.last.state


def _nearest_start(model: SerialModel, counts: Array, parameters: Array) -> Array:
    starts = model.starts(counts, parameters)
    nowhere = np.zeros((len(parameters), 0))
    errors = [np.sum(model.linearise(u, parameters, nowhere).closure ** 2, axis=1) for u in starts]
    return np.asarray(starts[np.argmin(errors, axis=0), np.arange(len(counts))])


def _evaluation(
    model: SerialModel, space: ParameterSpace, counts: Array, parameters: Array, u: Array
) -> Evaluation[Array]:
    """Closure errors with the unsensed coordinates eliminated, and their derivative."""
    unsensed = model.unsensed
    for _ in range(_INNER if len(unsensed) else 0):
        at = model.linearise(u, parameters, space.expansion[:, :0])
        inverse = np.linalg.pinv(at.closure_by_coordinates[:, :, unsensed], rcond=1e-9)
        step = -(inverse @ at.closure[:, :, None])[:, :, 0]
        u[:, unsensed] += np.clip(step, -0.5, 0.5)
        if np.abs(step).max() < _AT_REST:
            break
    at = model.linearise(u, parameters, space.expansion)
    jacobian = at.closure_by_parameters + at.closure_by_coordinates[:, :, model.sensed] @ (
        model.sensing.by_parameters(counts, space.expansion)
    )
    if len(unsensed):
        by_unsensed = at.closure_by_coordinates[:, :, unsensed]
        jacobian = jacobian - by_unsensed @ (np.linalg.pinv(by_unsensed, rcond=1e-9) @ jacobian)
    return Evaluation(at.closure.ravel(), jacobian.reshape(-1, jacobian.shape[2]), u)
