"""Where external trackers stand: a start for the estimator, because their nominal place may be anywhere.

The mechanism's own channels give the poses of its end at the nominal parameters. Tracker and
marker offsets then follow in turn: the rigid motion between where markers should be and where
they are seen (Arun, Huang & Blostein, "Least-squares fitting of two 3-D point sets", 1987),
and the mean of where each marker is seen on the end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.effects.grown import Grown
from solver.estimate.closing import placed
from solver.estimate.nuisance import Observations, assemble
from solver.mechanism.model import Model
from solver.mechanism.rotation import logarithm
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.mechanism.tracker import Tracked

Array = NDArray[np.float64]

_ROUNDS = 30  # of tracker and markers in turn; nothing but a start is asked of them


def located(model: Model, space: ParameterSpace, observed: Observations, start: Array) -> Array:
    """``start`` (N,) with identified trackers and markers moved to where they fit the poses.

    So are fixtures that the rig identifies without saying how well their place is known. A
    tracker whose frame is not identified in all six parts keeps its start.
    """
    if isinstance(model, Grown):
        plain, some = model.without_effects(space)
        if not some.names:
            return start
        begin = located(plain, some, observed, start[: model.named])
        return np.concatenate([begin, start[model.named :]])
    if isinstance(model, SerialModel):
        return placed(model, space, observed, start)
    if not isinstance(model, Tracked):
        return start
    x = start.copy()
    free = np.zeros(len(x), dtype=bool)
    free[space.identified] = True
    inside = Observations(observed.counts[:, model.own], observed.sigma[:, model.own], observed.at)
    coordinates = assemble(model.inner, inside, x)
    end = model.end_pose(coordinates, x, np.zeros((len(x), 0)))
    for stand in np.unique(model.tracker, axis=0):
        markers, seen = _seen(model, observed.counts, x, stand)
        if not len(markers) or not free[stand].all():
            continue
        for _ in range(_ROUNDS):
            arms = (x[markers] @ np.swapaxes(end.rotation, 1, 2)).swapaxes(0, 1)
            based = (end.position + arms).reshape(-1, 3)
            x[stand[:3]], axes = _frame(based, seen.reshape(-1, 3))
            x[stand[3:]] = logarithm(axes)
            apart = x[stand[:3]] + seen @ axes.T - end.position  # (markers, P, 3)
            offsets = np.mean((apart[:, :, None] @ end.rotation)[:, :, 0], axis=1)
            x[markers] = np.where(free[markers], offsets, x[markers])
    return x


def _seen(
    model: Tracked, counts: Array, parameters: Array, stand: NDArray[np.intp]
) -> tuple[NDArray[np.intp], Array]:
    """Offset indices (M, 3) and coordinates (M, P, 3) [m] of the markers that one tracker sees whole."""
    measured = model.sensing.values(counts[:, model.seen], parameters)
    mine = np.all(model.tracker == stand, axis=1)
    markers, points = [], []
    for marker in np.unique(model.marker[mine], axis=0):
        columns = np.flatnonzero(mine & np.all(model.marker == marker, axis=1))
        if len(columns) == 3:
            markers.append(marker)
            points.append(measured[:, columns[np.argsort(model.axis[columns])]])
    return np.array(markers, dtype=np.intp).reshape(-1, 3), np.array(points)


def _frame(based: Array, seen: Array) -> tuple[Array, Array]:
    """Origin (3,) and axes (3, 3) of the frame in which points at ``based`` (M, 3) are at ``seen``."""
    middle, looked = based.mean(axis=0), seen.mean(axis=0)
    left, _, right = np.linalg.svd((based - middle).T @ (seen - looked))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    axes = left @ mirror @ right
    return middle - axes @ looked, axes
