"""A session planned before it is run: which joints to drive, where to stop, what it will determine.

Candidates are reachable poses (`reach`, or within the tilt and swivel of a plate moved by
hand). The most informative of them are chosen as a solve chooses (`selection`), ordered for
short moves, and revisited as the plan's `revisit` says. The standard errors that the session
will reach are predicted from the noise of the channels and the length of the dwells: that is
what the Cramér-Rao bound promises, and what a solve of such a session reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Plan, Rig, SerialMechanism, parameters, visits
from solver.errors import MechanismError
from solver.estimate.identifiability import covariance, prior_width
from solver.estimate.nuisance import Observations, settle
from solver.mechanism.model import Model, model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.criteria import Criterion
from solver.poses.reach import drive_choices, reachable
from solver.poses.selection import select
from solver.poses.wander import wander

Array = NDArray[np.float64]

_CHOICES = 4  # sets of drives that are worked out
_CANDIDATES = 400
_DITHER = 0.5  # counts: a quieter channel does not average its quantisation away
_COUNTS = (10, 15, 20, 30, 40, 60, 80, 100, 150, 200)


@dataclass(frozen=True)
class Predicted:
    """What a number of poses will determine.

    Attributes:
        poses: distinct ones.
        errors: (n,) standard errors of the identified parameters, SI; inf where not determined.
        worst: index of the parameter whose error is largest for its stated uncertainty (or for
            its plausible error, where none is stated).
    """

    poses: int
    errors: Array
    worst: int


@dataclass(frozen=True)
class SessionPlan:
    """A planned session.

    Attributes:
        plan: ready to be written to a plan file.
        space: the parameters.
        coordinates: (N, U) the poses in the order of their visits.
        coordinate_names: names of the U coordinates.
        predicted: of the whole session, revisits included.
        by_poses: of shorter and longer sessions, without revisits.
        held: combinations that no pose determines, in words.
    """

    plan: Plan
    space: ParameterSpace
    coordinates: Array
    coordinate_names: tuple[str, ...]
    predicted: Predicted
    by_poses: tuple[Predicted, ...]
    held: tuple[str, ...]


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
    best: tuple[float, tuple[int, ...], Array, Array] | None = None
    for drives, coordinates in _candidates(rig, model, x, by_hand):
        jacobians = _jacobians(rig, model, space, x, coordinates, base)
        chosen = select(jacobians, min(count, len(coordinates)), "determinant").poses
        score = _score(space, jacobians[chosen])
        if best is None or score < best[0]:
            best = (score, drives, coordinates, jacobians)
    assert best is not None  # _candidates raises where there is none
    _, drives, coordinates, jacobians = best
    chosen = select(jacobians, min(count, len(coordinates)), criterion).poses
    chosen = chosen[_short_path(coordinates[chosen][:, drives] if drives else coordinates[chosen])]
    plan = _plan(rig, model, base, drives, coordinates[chosen], len(chosen), x)
    stops = jacobians[chosen[[visit.pose for visit in visits(plan)]]]
    cov, found = covariance(space, stops.reshape(-1, len(space.names)))
    return SessionPlan(
        plan,
        space,
        coordinates[chosen],
        model.coordinate_names,
        _predicted(space, len(chosen), cov),
        tuple(_by_poses(space, jacobians, criterion)),
        found.combinations,
    )


def _candidates(
    rig: Rig, model: Model, x: Array, by_hand: bool
) -> list[tuple[tuple[int, ...], Array]]:
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
    for drives in drive_choices(rig, model, x)[:_CHOICES]:
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
    if not out:
        raise MechanismError(refused[0])
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
    """(P, C, n) whitened by the standard errors of the planned dwells' means."""
    sigma = np.tile(mean_sigma(rig, plan), (len(coordinates), 1))
    readings = model.linearise(coordinates, x, space.expansion).readings
    return settle(model, Observations(readings, sigma), coordinates, x, space.expansion).jacobian


def mean_sigma(rig: Rig, plan: Plan) -> Array:
    """(C,) standard deviation [counts] of the mean of one dwell, as `samples.average` will find it.

    A dwell lasts as the plan says; where an operator rests longer, the errors come out smaller.
    """
    noise = np.array([channel.noise for channel in rig.channels])
    samples = max(plan.sample * plan.dwell, 1.0)
    rounded = np.sqrt(noise**2 + 1.0 / 12.0)
    return np.sqrt(rounded**2 / samples + np.where(rounded < _DITHER, 1.0 / 12.0, 0.0))


def _predicted(space: ParameterSpace, poses: int, cov: Array) -> Predicted:
    errors = np.sqrt(np.diag(cov))
    return Predicted(poses, errors, int(np.argmax(errors / prior_width(space))))


def _score(space: ParameterSpace, jacobians: Array) -> float:
    """Largest standard error for its stated uncertainty; infinite where something is not determined."""
    cov, found = covariance(space, jacobians.reshape(-1, len(space.names)))
    if found.held.shape[1]:
        return float("inf")
    return float((np.sqrt(np.diag(cov)) / prior_width(space)).max())


def _by_poses(space: ParameterSpace, jacobians: Array, criterion: Criterion) -> list[Predicted]:
    out = []
    for count in _COUNTS:
        if count >= len(jacobians):
            break
        # The quick criterion: the table compares sizes of sessions, not criteria.
        chosen = select(jacobians, count, "determinant" if criterion == "sigma_L" else criterion)
        cov, found = covariance(space, jacobians[chosen.poses].reshape(-1, len(space.names)))
        if not found.held.shape[1]:
            out.append(_predicted(space, count, cov))
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


def _plan(
    rig: Rig,
    model: Model,
    base: Plan,
    drives: Sequence[int],
    coordinates: Array,
    count: int,
    x: Array,
) -> Plan:
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
