"""Least squares in which what the data do not determine stays where its priors put it.

Null directions are found at the start and again at the solution; the search moves only
along directions that leave them at their priors (`identifiability.free_directions`). Where
the solution shows other null directions than the start did, it is searched again from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from solver.estimate.identifiability import (
    at_priors,
    free_directions,
    plausible_error,
    prior_width,
    undetermined,
)
from solver.estimate.trust_region import Evaluation, Minimum, State, Status, minimise
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_ROUNDS = 3
_SAME = 1e-3  # sine of the angle between null spaces that count as one


def minimise_held(
    evaluate: Callable[[Array, State | None], Evaluation[State] | None],
    start: Array,
    space: ParameterSpace,
    *,
    iterations: int = 100,
) -> Minimum[State] | None:
    """A minimum of whitened |r(z)|^2 over the directions that the data determine.

    Args:
        evaluate: residual and Jacobian at z (n,), as `trust_region.minimise` takes it.
        start: (n,).
        space: says what is nominal, how uncertain, and how wrong parameters may plausibly be.
        iterations: steps at most, in each round.

    Returns:
        The minimum with the full Jacobian (M, n) there, or None where ``start`` is not admissible.
    """
    here = evaluate(start, None)
    if here is None:
        return None
    z, steps = start, 0
    held = undetermined(space, here.jacobian)[0]
    for _ in range(_ROUNDS):
        minimum = _round(evaluate, z, here, held, space, iterations)
        z, here, steps = minimum.variables, minimum.last, steps + minimum.iterations
        found = undetermined(space, here.jacobian)[0]
        same = found.shape == held.shape and (
            np.linalg.norm(found - held @ (held.T @ found), axis=0).max(initial=0.0) <= _SAME
        )
        held = found
        if same or minimum.status is not Status.CONVERGED:
            break
    return replace(minimum, iterations=steps)


def _round(
    evaluate: Callable[[Array, State | None], Evaluation[State] | None],
    z: Array,
    here: Evaluation[State],
    held: Array,
    space: ParameterSpace,
    iterations: int,
) -> Minimum[State]:
    """One search with ``held`` (n, k), in plausible units, at its priors."""
    if held.shape[1]:
        anchor, here = _anchored(evaluate, z, here, held, space)
        free = free_directions(plausible_error(space)[:, None] * held, prior_width(space))
    else:
        anchor, free = z, np.eye(len(z))

    def along(y: Array, state: State | None) -> Evaluation[State] | None:
        at = here if state is None else evaluate(anchor + free @ y, state)
        return None if at is None else replace(at, jacobian=at.jacobian @ free)

    minimum = minimise(along, np.zeros(free.shape[1]), iterations=iterations)
    assert minimum is not None  # the start was evaluated above
    last = minimum.last
    z = anchor + free @ minimum.variables
    full = evaluate(z, last.state) if held.shape[1] else last
    return replace(minimum, variables=z, last=last if full is None else full)


def _anchored(
    evaluate: Callable[[Array, State | None], Evaluation[State] | None],
    z: Array,
    here: Evaluation[State],
    held: Array,
    space: ParameterSpace,
) -> tuple[Array, Evaluation[State]]:
    """``z`` moved to the priors along ``held``, as far as the mechanism can be evaluated there."""
    directions = plausible_error(space)[:, None] * held
    wanted = at_priors(z, space.reduce(space.nominal), directions, prior_width(space))
    for share in (1.0, 0.5, 0.25):
        moved = z + share * (wanted - z)
        there = evaluate(moved, here.state)
        if there is not None:
            return moved, there
    return z, here
