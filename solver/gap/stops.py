"""Stops that a next session could make: feasible poses, and under what they would be read.

Owns the circumstances of stops to come (time, side of approach, loads, noise) and the order of
their visits. Which of them tell rivals apart is the business of `next_poses`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from recordings.rig import Plan, SerialMechanism, visits
from recordings.rig.plan import Revisit
from solver.effects.effect import Array
from solver.gap.fit import Fit
from solver.gap.separation import Contest
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import Model, mechanism_model
from solver.mechanism.statics import loads
from solver.poses.fixtures import in_every_fixture
from solver.poses.planning import plan_at, reachable_poses

VISITS = 3
"""Of every pose: fewer would leave noise from visit to visit unknown."""

_CHOICES = 3  # sets of drives that are looked at
_CANDIDATES = 200
_ORDERS = 40  # orders of the visits that are compared
_MOVE_S = 1.0  # on the way between two stops, roughly

Merit = Callable[[Sequence[Array]], Array]
"""What sums of products (..., m, m), one a contest, are worth (...)."""


@dataclass(frozen=True)
class Visited:
    """A session: its plan, its S stops with their circumstances, and the sums with all of them."""

    plan: Plan
    stops: Array
    at: Circumstances
    sums: tuple[Array, ...]


@dataclass(frozen=True)
class Reach:
    """P feasible poses of one set of drives.

    Attributes:
        fit: the model by which they are feasible.
        drives: indices of the driven coordinates; none by hand.
        places: (P, U) the poses in each of the rig's fixtures, or in none.
        sigma: (C,) standard deviation of a stop's readings [counts].
    """

    fit: Fit
    drives: tuple[int, ...]
    places: tuple[Array, ...]
    sigma: Array

    @property
    def coordinates(self) -> Array:
        """(P, U) the poses, in the first fixture."""
        return self.places[0]

    @property
    def base(self) -> Plan:
        """The rig's plan, or one like it: how long to dwell and how fast to move."""
        plan = self.fit.model.site.rig.plan
        if plan is None or (plan.mode == "driven") != bool(self.drives):
            return Plan.model_validate({"mode": "by-hand"})
        return plan

    def sums(self, contests: Sequence[Contest]) -> tuple[Array, ...]:
        """For each contest (P, m, m) of one visit of each pose, the mean of either side."""
        return tuple(self._over(contest, contest.each) for contest in contests)

    def summed(self, contest: Contest) -> Array:
        """(m, m) of one visit of all poses."""
        return self._over(contest, contest.summed)

    def _over(
        self, contest: Contest, sums: Callable[[Array, Circumstances, Array], Array]
    ) -> Array:
        sides = (1.0, -1.0) if "approach" in contest.needs else (1.0,)
        time = np.full(len(self.coordinates), self._lasts(10))
        parts = [
            sums(u, self._at(u, number, time, np.full(u.shape[0], side)), self.sigma)
            for side in sides
            for number, u in enumerate(self.places)
        ]
        return np.asarray(np.sum(parts, axis=0) / len(sides))

    def values(self) -> Array:
        """(P, C) true values of the channels' places at all poses [rad or m]."""
        u = self.coordinates
        at = self._at(u, 0, np.full(len(u), self._lasts(10)))
        return self.fit.model.values(u, self.fit.parameters, at)

    def plan(self, chosen: Sequence[int]) -> Plan:
        """A session at some of the poses, each visited `VISITS` times."""
        model = self.fit.model
        rig, x = model.site.rig, self.fit.parameters[: model.named]
        poses = self.coordinates[list(chosen)]
        plan = plan_at(rig, _plain(self.fit), self.base, self.drives, poses, len(poses), x)
        return plan.model_copy(update={"revisit": Revisit(poses=len(poses), visits=VISITS)})

    def visited(
        self,
        chosen: Sequence[int],
        contests: Sequence[Contest],
        captured: Sequence[Array],
        merit: Merit,
    ) -> Visited:
        """The session at the poses ``chosen`` in the order that tells most."""
        plan = self.plan(chosen)
        needed = {n for c in contests for n in c.needs}
        best: tuple[float, Visited] | None = None
        for seed in range(plan.seed, plan.seed + (_ORDERS if "approach" in needed else 1)):
            one = plan.model_copy(update={"seed": seed})
            order = np.array([chosen[visit.pose] for visit in visits(one)])
            time = self._lasts(1) * (1.0 + np.arange(len(order)))
            sums = list(captured)
            places = [(number, u[order]) for number, u in enumerate(self.places)]
            where = [self._at(u, number, time + number * time[-1]) for number, u in places]
            for (_, u), at in zip(places, where, strict=True):
                sums = [
                    s + c.each(u, at, self.sigma).sum(axis=0)
                    for s, c in zip(sums, contests, strict=True)
                ]
            value = float(merit(sums))
            if best is None or value > best[0] + 1e-9:
                best = (value, Visited(one, places[0][1], where[0], tuple(sums)))
        assert best is not None  # there is one order at the least
        return best[1]

    def _lasts(self, stops: int) -> float:
        return stops * (self.base.dwell + self.base.settle + _MOVE_S)

    def _at(
        self, u: Array, fixture: int, time_s: Array, side: Array | None = None
    ) -> Circumstances:
        """Of stops (S, U) in a fixture; ``side`` (S,) they are reached from, or that of their order."""
        model, known = self.fit.model, self.fit.at
        rig, x = model.site.rig, self.fit.parameters[: model.named]
        number = np.full(len(u), fixture, dtype=np.intp) if len(self.places) > 1 else None
        shape = (len(u), len(model.channels))
        if side is None:
            where = Circumstances(fixture=number)
            counts = _plain(self.fit).linearise(u, x, np.zeros((len(x), 0)), where).readings
            approach = _sides(counts * np.sign(x[model.sensing.gain]))
        else:
            approach = np.tile(side[:, None], shape[1])
        begun = 0.0 if known.time_s is None else float(known.time_s.max())
        at = Circumstances(
            fixture=number,
            time_s=begun + time_s,
            begun_s=np.full(len(u), begun),
            approach=None if known.approach is None else approach,
            rate=np.zeros(shape),
            noise=None if known.noise is None else np.tile(known.noise[0], (len(u), 1)),
        )
        held = np.zeros((len(u), len(rig.mechanism.places)), dtype=bool)
        held[:, list(self.drives)] = True
        found = loads(rig, u, x, held, at)
        return at.loaded(found.torque, found.force, found.moment)


def reaches(fit: Fit, sigma: Array) -> tuple[Reach, ...]:
    """What sets of drives can reach, or a hand.

    Args:
        fit: the model.
        sigma: (C,) standard deviations of a dwell's mean counts.

    Raises:
        MechanismError: nothing can be reached safely.
    """
    rig, x = fit.model.site.rig, fit.parameters[: fit.model.named]
    by_hand = not isinstance(rig.mechanism, SerialMechanism) or (
        rig.plan is not None and rig.plan.mode == "by-hand"
    )
    plain, out = _plain(fit), []
    for drives, poses in reachable_poses(rig, plain, x, by_hand)[:_CHOICES]:
        some = poses
        if len(poses) > _CANDIDATES:
            rng = np.random.default_rng(0)
            some = poses[np.sort(rng.choice(len(poses), _CANDIDATES, replace=False))]
        places, _ = in_every_fixture(rig, plain, x, drives, some)
        out.append(Reach(fit, drives, tuple(there for _, there in places), sigma))
    return tuple(out)


def _plain(fit: Fit) -> Model:
    return mechanism_model(fit.model.site.rig, fit.model.site.table)


def _sides(values: Array) -> Array:
    """(S, C) from which side each channel reaches the stops (S, C), one after the other."""
    moved = np.sign(np.diff(values, axis=0, prepend=values.mean(axis=0)[None]))
    for row in range(1, len(moved)):
        moved[row] = np.where(moved[row] == 0, moved[row - 1], moved[row])
    return np.asarray(moved)
