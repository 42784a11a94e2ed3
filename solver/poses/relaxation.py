"""The best that any choice of n of P poses could reach, by concave relaxation and its dual.

The relaxed problem weighs poses by 0 <= w_i <= 1 with sum w_i = n. Its solution is the start
of a search for sets; what its dual gives bounds every set, however it was found.

"determinant" and "trace" are smooth: Frank-Wolfe steps, each of which gives a bound (the sum
of the n largest <Z, M_i>). For the extreme eigenvalues of "sigma_L" and "condition", cutting
planes: a linear program in w, a, b with a cut v' (sum w_i M_i) v >= a for each direction v
found so far (and <= b for the largest eigenvalue) that maximises a - t b, t = 0 or the best
ratio so far (Dinkelbach); the multipliers of the cuts are the weights of Z = sum mu v v'
(and Y).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize_scalar

from solver.poses.criteria import Criterion, uphill, worth

Array = NDArray[np.float64]

_CUT_ROUNDS = 40
_STEPS = 300
_TOLERANCE = 2e-3  # of the criterion's square: 0.1 % of the criterion


def relax(criterion: Criterion, information: Array, count: int) -> tuple[Array, float]:
    """Relaxed weights (P,), and an upper bound on the criterion's square for any ``count`` poses.

    Args:
        criterion: what to maximise.
        information: (P, n, n) of each pose.
        count: size of the sets.
    """
    if criterion in ("determinant", "trace"):
        return _frank_wolfe(criterion, information, count)
    return _cutting_planes(criterion, information, count)


def _frank_wolfe(criterion: Criterion, information: Array, count: int) -> tuple[Array, float]:
    weights = np.full(len(information), count / len(information))
    bound = np.inf
    for _ in range(_STEPS):
        total = np.tensordot(weights, information, axes=1)
        gains = np.einsum("nm,pnm->p", uphill(criterion, total), information)
        best = np.argpartition(-gains, count - 1)[:count]
        bound = min(bound, float(gains[best].sum()))
        reached = float(worth(criterion, total))
        if bound - reached <= _TOLERANCE * bound:
            break
        corner = information[best].sum(axis=0)

        def loss(share: float, here: Array = total, there: Array = corner) -> float:
            return -float(worth(criterion, here + share * (there - here)))

        share = float(minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded").x)
        if -loss(share) <= reached:
            break
        weights = (1.0 - share) * weights
        weights[best] += share
    return weights, bound


def _cutting_planes(criterion: Criterion, information: Array, count: int) -> tuple[Array, float]:
    poses, size = information.shape[:2]
    ratio = criterion == "condition"
    weights = np.full(poses, count / poses)
    low, high = np.empty((0, poses)), np.empty((0, poses))
    best, reached, bound = weights, -np.inf, np.inf
    for _ in range(_CUT_ROUNDS):
        values, vectors = np.linalg.eigh(np.tensordot(weights, information, axes=1))
        here = float(values[0] / values[-1]) if ratio else float(values[0])
        if here > reached:
            best, reached = weights, here
        if np.isfinite(bound) and bound - reached <= _TOLERANCE * bound:
            break
        seen = np.einsum("nk,pnm,mk->kp", vectors, information, vectors)
        low = np.vstack([low, seen[: max(3, size // 2)]])
        if ratio:
            high = np.vstack([high, seen[-max(3, size // 2) :]])
        # Variables w (P), a, b: maximise a - t b with low @ w >= a, high @ w <= b.
        t = max(reached, 0.0) if ratio else 0.0
        solved = linprog(
            np.concatenate([np.zeros(poses), [-1.0, t]]),
            A_ub=np.block(
                [
                    [-low, np.ones((len(low), 1)), np.zeros((len(low), 1))],
                    [high, np.zeros((len(high), 1)), -np.ones((len(high), 1))],
                ]
            ),
            b_ub=np.zeros(len(low) + len(high)),
            A_eq=np.concatenate([np.ones(poses), [0.0, 0.0]])[None],
            b_eq=[float(count)],
            bounds=[(0.0, 1.0)] * poses + [(None, None), (0.0, None)],
            method="highs",
        )
        if solved.x is None:
            break
        multipliers = np.maximum(-solved.ineqlin.marginals, 0.0)
        lower, upper = multipliers[: len(low)] @ low, multipliers[len(low) :] @ high
        trace = float(multipliers[: len(low)].sum()), float(multipliers[len(low) :].sum())
        if trace[0] > 0 and not ratio:
            bound = min(bound, float(np.sort(lower / trace[0])[-count:].sum()))
        elif min(trace) > 0:
            bound = min(bound, _largest_ratio(lower / trace[0], upper / trace[1], count))
        # Cutting planes alone jump between corners: stay near the best weights so far.
        weights = 0.5 * (solved.x[:poses] + best)
    if not np.isfinite(bound):
        traces = np.trace(information, axis1=1, axis2=2) / size
        bound = 1.0 if ratio else float(np.sort(traces)[-count:].sum())
    return best, bound


def _largest_ratio(above: Array, below: Array, count: int) -> float:
    """Largest sum of ``above`` over sum of ``below``, (P,) both, for any ``count`` of them (Dinkelbach)."""
    ratio = 0.0
    while True:
        best = np.argpartition(-(above - ratio * below), count - 1)[:count]
        low = float(below[best].sum())
        if low <= 0:
            return 1.0
        found = float(above[best].sum()) / low
        if found <= ratio * (1 + 1e-12):
            return min(max(found, ratio), 1.0)
        ratio = found
