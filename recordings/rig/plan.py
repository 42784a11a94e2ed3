"""The capture plan: which poses a session visits, in which order, and how long it stays.

Owns the plan table of a rig and its expansion into visits. Refuses to know kinematics: a
plan's region is a set of drive-joint readings that its author knows to be reachable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from recordings.rig.quantity import COORDINATE, Described, fail


class Revisit(Described):
    """How many poses are visited again, and how often each of them is visited in all."""

    poses: int = 10
    visits: int = 3

    @model_validator(mode="after")
    def _counts_are_positive(self) -> Revisit:
        if self.poses < 0 or self.visits < 1:
            raise fail(
                f"revisit has poses = {self.poses}, visits = {self.visits}; expected poses >= 0, visits >= 1"
            )
        return self


class Plan(Described):
    """A session: ``driven`` by joints in position mode, or ``by-hand``.

    The poses of a driven plan are either listed (``targets``: one row a pose, one reading
    a drive joint) or spread over the convex region whose corners are ``corners``, in the
    readings of the drive joints. By hand, the operator chooses; ``tilt`` and ``swivel``
    then say how far a platform's plate may be turned from its neutral pose.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "sample": ("hz",),
        "dwell": ("s",),
        "settle": ("s",),
        "targets": COORDINATE,
        "corners": COORDINATE,
        "tilt": ("deg", "rad"),
        "swivel": ("deg", "rad"),
        "move": ("deg_per_s", "m_per_s"),
    }

    mode: Literal["driven", "by-hand"]
    sample: float = 100.0
    poses: int = 60
    dwell: float = 0.5
    settle: float = 0.3
    revisit: Revisit = Revisit()
    seed: int = 1
    drives: tuple[str, ...] = ()
    targets: tuple[tuple[float, ...], ...] | None = None
    corners: tuple[tuple[float, ...], ...] | None = None
    tilt: float | None = None
    swivel: float | None = None
    move: float = 0.5

    @model_validator(mode="after")
    def _mode_has_what_it_needs(self) -> Plan:
        for key, value in (
            ("sample_hz", self.sample),
            ("dwell_s", self.dwell),
            ("move", self.move),
        ):
            if value <= 0:
                raise fail(f"'{key}' is {value}, expected above 0")
        for key, value in (("settle_s", self.settle), ("seed", self.seed)):
            if value < 0:
                raise fail(f"'{key}' is {value}, expected 0 or above")
        if self.poses < 1:
            raise fail(f"'poses' is {self.poses}, expected at least 1")
        if self.mode == "by-hand":
            if self.drives or self.targets or self.corners:
                raise fail(
                    "a by-hand plan has no 'drives', 'targets' or 'corners': the operator moves"
                )
            return self
        if not self.drives:
            raise fail("a driven plan needs 'drives': the joints held in position mode")
        if (self.targets is None) == (self.corners is None):
            raise fail(
                "a driven plan needs either 'targets' (a row a pose) or 'corners' of a region, not both"
            )
        for row in self.targets or self.corners or ():
            if len(row) != len(self.drives):
                raise fail(
                    f"a row of the plan has {len(row)} values, expected one a drive joint ({len(self.drives)})"
                )
        if self.corners is not None and len(self.corners) < len(self.drives) + 1:
            raise fail(
                f"'corners' has {len(self.corners)} rows, expected at least {len(self.drives) + 1}"
            )
        if len(set(self.drives)) < len(self.drives):
            raise fail(f"'drives' names a joint twice: {', '.join(self.drives)}")
        if self.corners is not None:
            edges = np.array(self.corners[1:]) - np.array(self.corners[0])
            if np.linalg.matrix_rank(edges) < len(self.drives):
                raise fail("'corners' span no region: they lie on one point, line or plane")
        return self


@dataclass(frozen=True, slots=True)
class Visit:
    """One stop of a session.

    Attributes:
        pose: number of the pose; the same at every visit of it.
        visit: 0 at the first visit of the pose, then 1, 2, ...
        targets: readings to which the drive joints go [rad or m], empty when moved by hand.
    """

    pose: int
    visit: int
    targets: tuple[float, ...]


def visits(plan: Plan, poses: int | None = None) -> tuple[Visit, ...]:
    """The stops of a session in order: every pose once, then the revisits in random order.

    Neighbours in the list are near each other, so that moves are short; revisits are in
    random order, so that what drifts during the session is not mistaken for the pose.

    Args:
        plan: the plan table of the rig.
        poses: number of distinct poses, in place of the plan's own.
    """
    rng = np.random.default_rng(plan.seed)
    count = plan.poses if poses is None else poses
    if plan.mode == "by-hand":
        where: list[tuple[float, ...]] = [()] * count
    elif plan.targets is not None:
        where = list(plan.targets[:count])
    else:
        where = [
            tuple(row) for row in _short_path(_spread(np.array(plan.corners), count, plan.seed))
        ]
    again = rng.choice(len(where), size=min(plan.revisit.poses, len(where)), replace=False)
    extra = [
        (int(pose), visit)
        for visit in range(1, plan.revisit.visits)
        for pose in rng.permutation(again)
    ]
    return tuple(
        Visit(pose, visit, where[pose])
        for pose, visit in [(p, 0) for p in range(len(where))] + extra
    )


def _spread(corners: NDArray[np.float64], count: int, seed: int) -> NDArray[np.float64]:
    """``count`` low-discrepancy points of the convex hull of ``corners``, shape (count, drives)."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    if corners.shape[1] == 1:
        line: NDArray[np.float64] = low + _additive(1, count, seed) * (high - low)
        return line
    drawn = 2 * count
    while True:
        points: NDArray[np.float64] = low + _additive(corners.shape[1], drawn, seed) * (high - low)
        inside = points[_within(points, corners)]
        if len(inside) >= count:
            return inside[:count]
        drawn *= 2


def _within(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (P, d) lie in the convex hull of ``corners`` (C, d)."""
    if corners.shape[1] > 2:
        from scipy.spatial import Delaunay  # slow to import, and two drives are the usual case

        found: NDArray[np.bool_] = Delaunay(corners).find_simplex(points) >= 0
        return found
    # A point is inside when every edge that has all corners on its left has the point there too.
    inside = np.ones(len(points), dtype=bool)
    for start in corners:
        for along in corners - start:
            left = along[0] * (corners - start)[:, 1] - along[1] * (corners - start)[:, 0]
            if np.any(along) and (left >= -1e-12).all():
                off = points - start
                inside &= along[0] * off[:, 1] - along[1] * off[:, 0] >= 0
    return inside


def _additive(dimensions: int, count: int, seed: int) -> NDArray[np.float64]:
    """Points (count, dimensions) of the unit cube: multiples of 1/g, 1/g^2, ... modulo 1.

    g solves g^(d+1) = g + 1, the golden ratio for d = 1 (Roberts, "The unreasonable
    effectiveness of quasirandom sequences", 2018); the seed shifts the sequence.
    """
    g = 2.0
    for _ in range(40):
        g = (1.0 + g) ** (1.0 / (dimensions + 1))
    start = np.random.default_rng(seed).random(dimensions)
    steps = np.arange(1, count + 1)[:, None] * g ** -np.arange(1.0, dimensions + 1)
    points: NDArray[np.float64] = (start + steps) % 1.0
    return points


def _short_path(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """``points`` ordered so that each is followed by its nearest neighbour not yet visited."""
    left = list(range(1, len(points)))
    path = [0]
    while left:
        steps = np.linalg.norm(points[left] - points[path[-1]], axis=1)
        path.append(left.pop(int(np.argmin(steps))))
    return points[path]
