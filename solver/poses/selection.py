"""Choosing n of P poses, with a bound on what any choice could reach.

The relaxed problem (`relaxation`) is rounded, then improved by exchanging one pose at a time:
each exchange adds one pose's information to the set's and takes another's away, a low-rank
update, and the best of the promising exchanges is taken while the criterion grows. The bound
of the relaxation holds for every set, so the result says how far from the best it can be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.errors import SolverError
from solver.poses.criteria import Criterion, uphill, worth
from solver.poses.relaxation import relax

Array = NDArray[np.float64]

_CANDIDATE_SWAPS = 256
_EXCHANGES = 200


@dataclass(frozen=True)
class Selection:
    """A chosen set of poses.

    Attributes:
        poses: (n,) indices, ascending.
        value: the criterion of the set's Jacobian, in the scaling of ``scale``; larger is better.
        upper_bound: no set of n poses exceeds this.
        scale: (n,) column scale: 1 / root mean square column norm over all poses, times
            1 / sqrt(n), so that a typical set has unit columns.
        criterion: what was maximised: see `criteria`.
    """

    poses: NDArray[np.intp]
    value: float
    upper_bound: float
    scale: Array
    criterion: Criterion = "sigma_L"


def select(jacobians: Array, count: int, criterion: Criterion = "sigma_L") -> Selection:
    """Exactly ``count`` poses that make the criterion large.

    Args:
        jacobians: (P, E, n), each pose's rows of the identification Jacobian.
        count: how many to choose; all are taken when there are no more than that.
        criterion: what to maximise.

    Raises:
        SolverError: ``count`` is below 1, or there is no pose.
    """
    poses = len(jacobians)
    if count < 1 or poses < 1:
        raise SolverError(f"cannot choose {count} of {poses} poses; expected at least one of each")
    norms = np.sqrt(np.sum(jacobians**2, axis=(0, 1)))
    scale = np.where(
        norms > 0, np.sqrt(poses / min(count, poses)) / np.where(norms > 0, norms, 1.0), 1.0
    )
    rows = jacobians * scale
    information = np.swapaxes(rows, 1, 2) @ rows
    if count >= poses:
        value = _root(worth(criterion, information.sum(axis=0)))
        return Selection(np.arange(poses), value, value, scale, criterion)
    weights, bound = relax(criterion, information, count)
    chosen = _exchange(criterion, information, np.argsort(-weights, kind="stable")[:count])
    value = _root(worth(criterion, information[chosen].sum(axis=0)))
    return Selection(np.sort(chosen), value, max(_root(bound), value), scale, criterion)


def _root(value: Array | float) -> float:
    return float(np.sqrt(max(float(value), 0.0)))


def _exchange(
    criterion: Criterion, information: Array, chosen: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Swap one pose at a time, the best of the promising swaps, while the criterion grows."""
    inside = np.zeros(len(information), dtype=bool)
    inside[chosen] = True
    total = information[inside].sum(axis=0)
    reached = float(worth(criterion, total))
    for _ in range(_EXCHANGES):
        gain = np.einsum("nm,pnm->p", uphill(criterion, total), information)
        within, without = np.flatnonzero(inside), np.flatnonzero(~inside)
        promise = gain[without][None, :] - gain[within][:, None]
        most = min(_CANDIDATE_SWAPS, promise.size)
        flat = np.argpartition(-promise.ravel(), most - 1)[:most]
        out, into = within[flat // len(without)], without[flat % len(without)]
        trials = total + information[into] - information[out]
        values = worth(criterion, trials)
        best = int(np.argmax(values))
        if values[best] <= reached * (1 + 1e-9):
            break
        inside[out[best]], inside[into[best]] = False, True
        total, reached = trials[best], float(values[best])
    return np.flatnonzero(inside)
