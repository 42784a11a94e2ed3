"""Choosing n of P poses for the largest smallest singular value, with a bound on what any choice could reach.

With M_i the information of pose i (its Jacobian rows, columns scaled), the criterion of a
set is sigma_L = sqrt(lambda_min(sum of M_i)). For any Z >= 0 of trace 1 and any set of n
poses, lambda_min(sum M_i) <= <Z, sum M_i> <= the sum of the n largest <Z, M_i>: a bound on
every set. Minimising it over Z is the dual of the concave relaxation

    maximise lambda_min(sum w_i M_i)   subject to  0 <= w_i <= 1, sum w_i = n,

solved here by cutting planes: a linear program in w with a cut v' (sum w_i M_i) v >= t for
each direction v found so far; the multipliers of the cuts are the weights of Z = sum mu v v'.
The relaxed weights are rounded, then improved by exchanging one pose at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

Array = NDArray[np.float64]

_CUT_ROUNDS = 40
_BOUND_TOLERANCE = 2e-3  # of lambda: 0.1 % of sigma_L
_CANDIDATE_SWAPS = 256
_EXCHANGES = 200


@dataclass(frozen=True)
class Selection:
    """A chosen set of poses.

    Attributes:
        poses: (n,) indices, ascending.
        value: sigma_L of the set's Jacobian, in the scaling of ``scale``.
        upper_bound: no set of n poses exceeds this sigma_L.
        scale: (n,) column scale: 1 / root mean square column norm over all poses, times
            1 / sqrt(n), so that a typical set has unit columns.
    """

    poses: NDArray[np.intp]
    value: float
    upper_bound: float
    scale: Array


def select(jacobians: Array, count: int) -> Selection:
    """The ``count`` poses that make the smallest singular value largest.

    Args:
        jacobians: (P, E, n), each pose's rows of the identification Jacobian.
        count: how many to choose; all are taken when there are no more than that.
    """
    poses = len(jacobians)
    norms = np.sqrt(np.sum(jacobians**2, axis=(0, 1)))
    scale = np.where(
        norms > 0, np.sqrt(poses / min(count, poses)) / np.where(norms > 0, norms, 1.0), 1.0
    )
    rows = jacobians * scale
    information = np.swapaxes(rows, 1, 2) @ rows
    if count >= poses:
        value = _root(np.linalg.eigvalsh(information.sum(axis=0))[0])
        return Selection(np.arange(poses), value, value, scale)
    weights, bound = _relax(information, count)
    chosen = _exchange(information, np.argsort(-weights, kind="stable")[:count])
    value = _root(np.linalg.eigvalsh(information[chosen].sum(axis=0))[0])
    return Selection(np.sort(chosen), value, max(_root(bound), value), scale)


def _root(value: float) -> float:
    return float(np.sqrt(max(value, 0.0)))


def _relax(information: Array, count: int) -> tuple[Array, float]:
    """Relaxed weights (P,) and the upper bound on lambda_min of any set of ``count`` poses."""
    poses, size = len(information), information.shape[1]
    weights = np.full(poses, count / poses)
    cuts = np.empty((0, poses))
    best_weights, reached, bound = weights, -np.inf, np.inf
    for _ in range(_CUT_ROUNDS):
        values, vectors = np.linalg.eigh(np.tensordot(weights, information, axes=1))
        if values[0] > reached:
            best_weights, reached = weights, float(values[0])
        if np.isfinite(bound) and bound - reached <= _BOUND_TOLERANCE * bound:
            break
        seen = np.einsum("nk,pnm,mk->kp", vectors, information, vectors)
        cuts = np.vstack([cuts, seen[: max(3, size // 2)]])
        # Variables w (P) and t: maximise t with cuts @ w >= t.
        solved = linprog(
            np.append(np.zeros(poses), -1.0),
            A_ub=np.column_stack([-cuts, np.ones(len(cuts))]),
            b_ub=np.zeros(len(cuts)),
            A_eq=np.append(np.ones(poses), 0.0)[None],
            b_eq=[float(count)],
            bounds=[(0.0, 1.0)] * poses + [(None, None)],
            method="highs",
        )
        if solved.x is None:
            break
        multipliers = np.maximum(-solved.ineqlin.marginals, 0.0)
        bound = min(bound, _dual_bound(cuts, multipliers, count))
        # Cutting planes alone jump between corners: stay near the best weights so far.
        weights = 0.5 * (solved.x[:-1] + best_weights)
    if not np.isfinite(bound):
        bound = _dual_bound(np.trace(information, axis1=1, axis2=2)[None] / size, np.ones(1), count)
    return best_weights, bound


def _dual_bound(cuts: Array, multipliers: Array, count: int) -> float:
    """Sum of the ``count`` largest <Z, M_i> for Z = sum of multipliers v v', normalised to trace 1."""
    total = multipliers.sum()
    if total <= 0:
        return float("inf")
    gains = (multipliers / total) @ cuts
    return float(np.sort(gains)[-count:].sum())


def _exchange(information: Array, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Swap one pose at a time, the best of the promising swaps, while lambda_min grows."""
    inside = np.zeros(len(information), dtype=bool)
    inside[chosen] = True
    total = information[inside].sum(axis=0)
    for _ in range(_EXCHANGES):
        values, vectors = np.linalg.eigh(total)
        # A soft minimum: directions near the smallest eigenvalue count too.
        width = 0.05 * max(values[0], 1e-12 * values[-1])
        weight = np.exp(-(values - values[0]) / width)
        Z = (vectors * (weight / weight.sum())) @ vectors.T
        gain = np.einsum("nm,pnm->p", Z, information)
        within, without = np.flatnonzero(inside), np.flatnonzero(~inside)
        promise = gain[without][None, :] - gain[within][:, None]
        most = min(_CANDIDATE_SWAPS, promise.size)
        flat = np.argpartition(-promise.ravel(), most - 1)[:most]
        out, into = within[flat // len(without)], without[flat % len(without)]
        trials = total + information[into] - information[out]
        smallest = np.linalg.eigvalsh(trials)[:, 0]
        best = int(np.argmax(smallest))
        if smallest[best] <= values[0] * (1 + 1e-9):
            break
        inside[out[best]], inside[into[best]] = False, True
        total = trials[best]
    return np.flatnonzero(inside)
