"""A driven session of a serial mechanism, solved as a whole.

Two passes. The first follows the loop from stop to stop through coarse knots, each solved
from the one before, so that the mechanism never changes its branch. The second closes the
loop at every sample at once, starting between the knots. All drives of a move start and
arrive together, on the straight line between two targets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Channel, Plan, Visit, parameters
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.loop import CLOSED, Loop
from sim_devices.plant.motion import Profile, move
from sim_devices.plant.nature import Nature
from sim_devices.plant.quaternion import Array
from sim_devices.plant.seeds import ASSEMBLY, stream
from sim_devices.plant.stop import FOLLOWING_ERROR, LEAD_S, REFERENCE_LIMIT, Stop

_ASTRAY = 0.1
"""A sample may be this far from the line between its knots [rad or m]."""
_FOLLOWED = 1e-3
"""A drive that stands within this of its target has followed [rad or m]."""


@dataclass(frozen=True, slots=True)
class Leg:
    """The move to one stop: ``profile`` runs from 0 to 1, its knots lie at ``shares`` of it."""

    profile: Profile
    first_knot: int
    shares: Array

    @property
    def end_knot(self) -> int:
        """Number of the knot at which the move ends."""
        return self.first_knot + len(self.shares) - 1


@dataclass(frozen=True, slots=True)
class Tour:
    """A driven session.

    Attributes:
        stops: in order of time.
        loop: what moves.
        held: (J,) joints in position mode.
        knots: (K, J) configurations passed.
        legs: one a stop.
    """

    stops: tuple[Stop, ...]
    loop: Loop
    held: NDArray[np.bool_]
    knots: Array
    legs: tuple[Leg, ...]

    def at_stops(self) -> Array:
        """(n, J) joint variables at the stops that were reached."""
        last = [leg.end_knot for leg in self.legs]
        reached = [not stop.faults for stop in self.stops]
        return np.asarray(self.knots[np.array(last)[reached]])

    def variables_at(self, time_s: Array) -> Array:
        """(n, J) joint variables at times (n,) in order.

        Raises:
            CannotSimulate: the loop cannot be followed between two knots.
        """
        at_knot = np.zeros(len(time_s))
        starts = np.searchsorted(time_s, [leg.profile.start_s for leg in self.legs])
        for leg, begin, end in zip(self.legs, starts, [*starts[1:], len(time_s)], strict=True):
            share = leg.profile.at(time_s[begin:end])
            at_knot[begin:end] = leg.first_knot + np.interp(
                share, leg.shares, np.arange(len(leg.shares))
            )
        if self.loop.is_steady:
            # Half of a session is rest: samples at one place of the path are solved once.
            at_knot, sample = np.unique(at_knot, return_inverse=True)
            return self._closed_at(at_knot, np.zeros(len(at_knot)))[sample]
        return self._closed_at(at_knot, time_s)

    def _closed_at(self, at_knot: Array, time_s: Array) -> Array:
        """(n, J) closed configurations at places of the path, counted in knots."""
        count = np.arange(len(self.knots))
        guess = np.stack([np.interp(at_knot, count, column) for column in self.knots.T], axis=1)
        closed, left = self.loop.polish(guess, self.held, time_s)
        lost = (left > CLOSED) | (np.abs(closed - guess).max(axis=1) > _ASTRAY)
        if lost.any():
            ends = [leg.end_knot for leg in self.legs]
            stop = self.stops[int(np.searchsorted(ends, at_knot[np.argmax(lost)]))]
            raise CannotSimulate(
                f"the loop cannot be followed on the way to pose {stop.pose}: the mechanism passes too "
                f"close to a singular configuration; move the region of the plan away from it"
            )
        return closed


def drive_joints(nature: Nature, plan: Plan) -> list[tuple[int, Channel]]:
    """Joint numbers of the plan's drives, with the channels that their servos follow."""
    joints = nature.rig.mechanism.places
    channels = {channel.senses: channel for channel in nature.rig.channels}
    return [(joints.index(name), channels[name]) for name in plan.drives]


def counts_for(channel: Channel, nominal: Mapping[str, float], reading: float) -> int:
    """Counts at which a channel should read ``reading`` [rad or m], as far as its rig file knows."""
    gain, offset = (nominal[f"{channel.name}.{part}"] for part in ("gain", "offset"))
    return channel.zero_count + round((reading - offset) / gain)


def drive_tour(
    nature: Nature, loop: Loop, visits: Sequence[Visit], plan: Plan, start_s: float = LEAD_S
) -> Tour:
    """Carry out the visits of a driven plan.

    A pose that the mechanism cannot reach is left out: its stop carries the drives' faults,
    and the next move starts from where the mechanism got to.

    Args:
        nature: the rig as it really is.
        loop: its mechanism.
        visits: in order.
        plan: speed and dwells.
        start_s: when the first move begins.

    Raises:
        CannotSimulate: the mechanism has fewer freedoms than the plan drives.
        MechanismDoesNotClose: there is no configuration to start from.
    """
    drives = drive_joints(nature, plan)
    nominal = {parameter.name: parameter.nominal for parameter in parameters(nature.rig)}
    held = [joint for joint, _ in drives]
    here = loop.assemble(stream(nature.truth.seed, ASSEMBLY))
    leading = loop.leaders(here, 0.0, held)
    if len(leading) < len(held):
        over = [plan.drives[k] for k, joint in enumerate(held) if joint not in leading]
        raise CannotSimulate(
            f"the plan drives {len(held)} joints, but the mechanism has only {len(leading)} freedoms "
            f"for them: '{over[0]}' would fight the others and fault; take it out of 'drives'"
        )
    knots, legs, stops = [here], [], []
    now = start_s
    for visit in visits:
        raw = [counts_for(c, nominal, t) for (_, c), t in zip(drives, visit.targets, strict=True)]
        target = np.array(
            [nature.sensors[c.name].value_at(r) for (_, c), r in zip(drives, raw, strict=True)]
        )
        faults = {
            name: REFERENCE_LIMIT
            for name, joint, t in zip(plan.drives, held, target, strict=True)
            if loop.clipped(joint, float(t)) != t
        }
        start = here[held]
        longest = 0.0 if faults else float(np.abs(target - start).max())
        profile, shares = Profile(now, 0.0, 1.0), np.zeros(1)
        first = len(knots) - 1
        if longest > 0.0:
            profile = move(now, 0.0, 1.0, plan.move / longest)
            passed, shares = loop.follow(here, held, target, profile.end_s)
            knots += list(passed[1:])
            here = passed[-1]
            if shares[-1] < 1.0:
                lag = np.abs(target - here[held]) > _FOLLOWED
                faults = {plan.drives[k]: FOLLOWING_ERROR for k in np.flatnonzero(lag)}
        legs.append(Leg(profile, first, shares))
        arrive = profile.end_s
        stop = Stop(
            visit.pose,
            visit.visit,
            now,
            arrive,
            arrive + plan.settle,
            arrive + plan.settle + plan.dwell,
            dict(zip(plan.drives, raw, strict=True)),
            faults,
        )
        stops.append(stop)
        now = stop.leave_s
    is_held = np.isin(np.arange(len(here)), held)
    knot_rows, _ = loop.polish(np.array(knots), is_held, np.zeros(len(knots)))
    return Tour(tuple(stops), loop, is_held, knot_rows, tuple(legs))
