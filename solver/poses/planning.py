"""A session planned before it is run: which joints to drive, where to stop, what it will determine.

Candidates are reachable poses (`reach`, or within the tilt and swivel of a plate moved by
hand). The most informative of them are chosen as a solve chooses (`selection`), ordered for
short moves, and revisited as the plan's `revisit` says. What the session will determine is said by
`prediction`; by hand, for poses as a hand picks them, and for those suggested. Where the rig has
several fixtures the session visits all stops in each of them (`fixtures`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Plan, Rig, SerialMechanism, parameters, visits
from solver.errors import MechanismError
from solver.estimate.identifiability import (
    Identifiability,
    covariance,
    identifiability,
    prior_width,
)
from solver.estimate.nuisance import Observations, settle
from solver.estimate.null_directions import point_frames
from solver.mechanism.model import Model, model_of
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.mobility import immobile, offset_determined, told
from solver.poses.criteria import Criterion
from solver.poses.fixtures import in_every_fixture
from solver.poses.prediction import Predicted, predict, predict_by_hand
from solver.poses.reach import drive_choices, reachable
from solver.poses.selection import select
from solver.poses.wander import wander

Array = NDArray[np.float64]

_CHOICES = 4  # sets of drives that are worked out
_CANDIDATES = 400
_SAYS_NOTHING = 1e-11  # of the largest singular value of any pose: only rounding
_DITHER = 0.5  # counts: a quieter channel does not average its quantisation away
_COUNTS = (10, 15, 20, 30, 40, 60, 80, 100, 150, 200)


@dataclass(frozen=True)
class SessionPlan:
    """A planned session.

    Attributes:
        plan: ready to be written to a plan file.
        space: the parameters.
        coordinates: (N, U) the poses in the order of their visits.
        coordinate_names: names of the U coordinates.
        predicted: of the whole session, revisits included; by hand, at poses as a hand picks them.
            None where these determine less than poses can.
        followed: by hand, of a session at the suggested poses instead; None where driven.
        by_poses: of shorter and longer sessions, without revisits.
        held: combinations that no pose determines, in words.
        still: joints that cannot move, and what that costs, in words.
    """

    plan: Plan
    space: ParameterSpace
    coordinates: Array
    coordinate_names: tuple[str, ...]
    predicted: Predicted | None
    followed: Predicted | None
    by_poses: tuple[Predicted, ...]
    held: tuple[str, ...]
    still: tuple[str, ...]


def plan_session(
    rig: Rig,
    *,
    values: Array | None = None,
    poses: int | None = None,
    criterion: Criterion = "sigma_L",
) -> SessionPlan:
    """Plan a capture of ``rig``.

    Args:
        rig: its plan table, where it has one, says how long to dwell, how often to revisit, and
            whether the mechanism is moved by hand.
        values: (N,) parameters from an earlier calibration, in the order of the rig's table, SI.
        poses: distinct poses, in place of the plan's own number.
        criterion: by which poses are chosen.

    Raises:
        MechanismError: it cannot be assembled, or nothing can be driven safely.
    """
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    if not space.names:
        raise MechanismError(
            f"rig '{rig.name}' identifies nothing, so there is nothing to plan for; set identify = true"
        )
    x = space.nominal if values is None else values
    by_hand = not isinstance(rig.mechanism, SerialMechanism) or (
        rig.plan is not None and rig.plan.mode == "by-hand"
    )
    base = rig.plan
    if base is None or (base.mode == "driven") == by_hand:
        base = Plan.model_validate({"mode": "by-hand"})
    count = base.poses if poses is None else poses
    known = model.pseudo_observations(x, space.expansion)[1]
    best: tuple[float, tuple[int, ...], Array, Array] | None = None
    for drives, coordinates in reachable_poses(rig, model, x, by_hand):
        places, kept = in_every_fixture(rig, model, x, drives, coordinates)
        coordinates = coordinates[kept]
        jacobians = np.concatenate(
            [_jacobians(rig, one, space, x, there, base) for one, there in places], axis=1
        )
        chosen = select(jacobians, min(count, len(coordinates)), "determinant").poses
        score = _score(space, jacobians[chosen], known)
        if best is None or score < best[0]:
            best = (score, drives, coordinates, jacobians)
    assert best is not None  # reachable_poses raises where there is none
    _, drives, coordinates, jacobians = best
    chosen = select(jacobians, min(count, len(coordinates)), criterion).poses
    chosen = chosen[_short_path(coordinates[chosen][:, drives] if drives else coordinates[chosen])]
    plan = plan_at(rig, model, base, drives, coordinates[chosen], len(chosen), x)
    stops = [visit.pose for visit in visits(plan)]
    rows = np.vstack([jacobians.reshape(-1, len(space.names)), known])
    found = identifiability(space, rows, x, point_frames(rig))
    suggested = predict(space, jacobians[chosen[stops]], len(chosen), found, known)
    picked = (
        predict_by_hand(space, jacobians, len(chosen), stops, found, known)
        if by_hand
        else suggested
    )
    return SessionPlan(
        plan,
        space,
        coordinates[chosen],
        model.coordinate_names,
        picked,
        suggested if by_hand else None,
        tuple(_by_poses(space, jacobians, criterion, found, known, by_hand)),
        found.combinations,
        _still(rig, model, space, x, coordinates, found),
    )


def _still(
    rig: Rig,
    model: Model,
    space: ParameterSpace,
    x: Array,
    coordinates: Array,
    found: Identifiability,
) -> tuple[str, ...]:
    """What is to be said of joints that stand still at all of ``coordinates`` (P, U)."""
    if not isinstance(model, SerialModel):
        return ()
    out = []
    for j in immobile(model, x, coordinates):
        name = model.coordinate_names[j]
        channel = rig.sensed_by(name)
        sensor = None if channel is None else channel.name
        known = offset_determined(space, found.held, name, sensor)
        out.append(told(name, determined=known))
    return tuple(out)


def reachable_poses(
    rig: Rig, model: Model, x: Array, by_hand: bool
) -> list[tuple[tuple[int, ...], Array]]:
    """Sets of drives with closed poses (P, U) that each can reach; by hand one without drives.

    Raises:
        MechanismError: nothing can be reached safely.
    """
    if by_hand:
        poses = wander(rig, model, x, 2 * _CANDIDATES, seed=1)
        seen = poses[_within_ranges(rig, model, x, poses)][:_CANDIDATES]
        if not len(seen):
            raise MechanismError(
                f"no pose within the tilt and swivel of rig '{rig.name}' keeps every channel within its count_range; "
                "`loopcal rig check` says which"
            )
        return [((), seen)]
    out, refused = [], []
    for drives in drive_choices(rig, model, x):
        try:
            region = reachable(rig, model, x, drives)
        except MechanismError as error:
            refused.append(str(error))
            continue
        some = region.coordinates
        if len(some) > _CANDIDATES:
            rng = np.random.default_rng(0)
            some = some[np.sort(rng.choice(len(some), _CANDIDATES, replace=False))]
        out.append((drives, some))
        if len(out) == _CHOICES:
            break
    if not out:
        others = f" (nor by any of {len(refused) - 1} other choices)" if len(refused) > 1 else ""
        raise MechanismError(f"{refused[0]}{others}")
    return out


def _within_ranges(rig: Rig, model: Model, x: Array, poses: Array) -> NDArray[np.bool_]:
    """Which poses (P, U) every channel can read."""
    counts = model.linearise(poses, x, np.zeros((len(x), 0))).readings
    ranges = [
        (-np.inf, np.inf)
        if channel.count_range is None or channel.modulus_counts is not None
        else channel.count_range
        for channel in rig.channels
    ]
    low, high = np.array(ranges).T
    return np.asarray(((counts >= low) & (counts <= high)).all(axis=1))


def _jacobians(
    rig: Rig, model: Model, space: ParameterSpace, x: Array, coordinates: Array, plan: Plan
) -> Array:
    """(P, R, n) whitened by the standard errors of the planned dwells' means.

    Of each pose only the R combinations of readings that the loop checks: the others say nothing.
    """
    sigma = np.tile(mean_sigma(rig, plan), (len(coordinates), 1))
    readings = model.linearise(coordinates, x, space.expansion).readings
    settled = settle(model, Observations(readings, sigma), coordinates, x, space.expansion)
    _, singular, right = np.linalg.svd(settled.jacobian, full_matrices=False)
    checked = int((singular > _SAYS_NOTHING * singular.max()).any(axis=0).sum())
    return np.asarray(singular[:, :checked, None] * right[:, :checked])


def mean_sigma(rig: Rig, plan: Plan) -> Array:
    """(C,) standard deviation [counts] of the mean of one dwell, as `samples.average` will find it.

    A dwell lasts as the plan says; where an operator rests longer, the errors come out smaller.
    """
    noise = np.array([channel.noise for channel in rig.channels])
    samples = max(plan.sample * plan.dwell, 1.0)
    rounded = np.sqrt(noise**2 + 1.0 / 12.0)
    return np.sqrt(rounded**2 / samples + np.where(rounded < _DITHER, 1.0 / 12.0, 0.0))


def _score(space: ParameterSpace, jacobians: Array, known: Array) -> float:
    """Largest standard error for its stated uncertainty; infinite where something is not determined."""
    cov, found = covariance(space, np.vstack([jacobians.reshape(-1, len(space.names)), known]))
    if found.held.shape[1]:
        return float("inf")
    return float((np.sqrt(np.diag(cov)) / prior_width(space)).max())


def _by_poses(
    space: ParameterSpace,
    jacobians: Array,
    criterion: Criterion,
    found: Identifiability,
    known: Array,
    by_hand: bool,
) -> list[Predicted]:
    out = []
    for count in _COUNTS:
        if count >= len(jacobians):
            break
        if by_hand:
            size = predict_by_hand(space, jacobians, count, range(count), found, known)
        else:
            # The quick criterion: the table compares sizes of sessions, not criteria.
            quick: Criterion = "determinant" if criterion == "sigma_L" else criterion
            chosen = select(jacobians, count, quick).poses
            size = predict(space, jacobians[chosen], count, found, known)
        if size is not None:
            out.append(size)
    return out


def _short_path(points: Array) -> NDArray[np.intp]:
    """Order (N,) in which each point is followed by the nearest one left; then crossings undone."""
    left, path = list(range(1, len(points))), [0]
    while left:
        steps = np.linalg.norm(points[left] - points[path[-1]], axis=1)
        path.append(left.pop(int(np.argmin(steps))))
    order = np.array(path, dtype=np.intp)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    improved = True
    while improved:
        improved = False
        for i in range(len(order) - 2):
            a, b = order[i], order[i + 1]
            ends = order[i + 2 :]
            after = np.append(order[i + 3 :], -1)
            closing = np.where(after >= 0, distance[b, after] - distance[ends, after], 0.0)
            change = distance[a, ends] + closing - distance[a, b]
            j = int(np.argmin(change))
            if change[j] < -1e-9:
                order[i + 1 : i + 3 + j] = order[i + 1 : i + 3 + j][::-1]
                improved = True
    return order


def plan_at(
    rig: Rig,
    model: Model,
    base: Plan,
    drives: Sequence[int],
    coordinates: Array,
    count: int,
    x: Array,
) -> Plan:
    """``base`` with the ``drives`` going to ``coordinates`` (P, U); by hand with ``count`` poses."""
    if not drives:
        return base.model_copy(update={"poses": count})
    names = [model.coordinate_names[drive] for drive in drives]
    nominal = {p.name: (p.nominal, float(v)) for p, v in zip(parameters(rig), x, strict=True)}
    targets = []
    for name, values in zip(names, coordinates[:, drives].T, strict=True):
        channel = rig.sensed_by(name)
        assert channel is not None  # drive_choices takes sensed joints only
        # A drive goes to counts: by the rig's own gain and offset it is told another reading.
        gain, true_gain = nominal[f"{channel.name}.gain"]
        offset, true_offset = nominal[f"{channel.name}.offset"]
        targets.append(gain * (values - true_offset) / true_gain + offset)
    rows = tuple(tuple(float(v) for v in row) for row in np.array(targets).T)
    return base.model_copy(
        update={
            "mode": "driven",
            "drives": tuple(names),
            "targets": rows,
            "corners": None,
            "poses": count,
        }
    )
