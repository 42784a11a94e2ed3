"""A driven session through all fixtures of a rig: a tour in each, and the way between them.

The plan is carried out once in every fixture, in the order of the rig file. Between two of
them somebody loosens the endpoint and carries it over: the drives are free, and the joints
go smoothly from where the one tour ended to where the next begins. On that way nothing closes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from recordings.rig import Plan, visits
from sim_devices.plant.errors import MechanismDoesNotClose
from sim_devices.plant.loop import Loop
from sim_devices.plant.motion import minimum_jerk
from sim_devices.plant.nature import Nature
from sim_devices.plant.quaternion import Array
from sim_devices.plant.stop import LEAD_S, Stop
from sim_devices.plant.tour import Tour, drive_tour

CARRY_S = 5.0
"""Time in which the endpoint is carried from one fixture to the next [s]."""


@dataclass(frozen=True, slots=True)
class Stay:
    """The part of a session that is spent in one fixture.

    Attributes:
        tour: what is done there.
        begin_s: the endpoint is in the fixture from then on.
    """

    tour: Tour
    begin_s: float


@dataclass(frozen=True, slots=True)
class Passage:
    """A driven session, fixture by fixture; one stay where the rig has one fixture or none."""

    stays: tuple[Stay, ...]

    @property
    def stops(self) -> tuple[Stop, ...]:
        """Of all stays, in order of time."""
        return tuple(stop for stay in self.stays for stop in stay.tour.stops)

    def pieces(self, time_s: Array) -> Iterator[tuple[Loop, Array, Array]]:
        """For each stay its loop, its share of ``time_s`` (n,) in order, and the (m, J) joint variables then.

        The way into a fixture belongs to its stay.

        Raises:
            CannotSimulate: a loop cannot be followed between two stops.
        """
        for k, stay in enumerate(self.stays):
            before = self.stays[k - 1].tour if k else None
            until = self.stays[k + 1].begin_s - CARRY_S if k + 1 < len(self.stays) else np.inf
            left_s = -np.inf if before is None else stay.begin_s - CARRY_S
            mine = time_s[(time_s >= left_s) & (time_s < until)]
            inside = mine >= stay.begin_s
            variables = np.empty((len(mine), stay.tour.knots.shape[1]))
            variables[inside] = stay.tour.variables_at(mine[inside])
            if before is not None:
                share = minimum_jerk((mine[~inside] - left_s) / CARRY_S)[:, None]
                start, end = before.knots[-1], stay.tour.knots[0]
                variables[~inside] = start + share * (end - start)
            yield stay.tour.loop, mine, variables


def drive_through(nature: Nature, plan: Plan, poses: int | None = None) -> Passage:
    """Carry out a driven plan in every fixture; each has poses of its own numbers.

    Args:
        nature: the rig as it really is.
        plan: what is done in each fixture.
        poses: number of distinct poses in each, in place of the plan's own.

    Raises:
        CannotSimulate: the mechanism has fewer freedoms than the plan drives.
        MechanismDoesNotClose: in a fixture there is no configuration to start from.
    """
    there = visits(plan, poses)
    count = 1 + max((visit.pose for visit in there), default=-1)
    stays: list[Stay] = []
    begin_s = 0.0
    for k, (fixture, loop) in enumerate(nature.loops.items()):
        here = [replace(visit, pose=visit.pose + k * count) for visit in there]
        try:
            tour = drive_tour(nature, loop, here, plan, begin_s + LEAD_S)
        except MechanismDoesNotClose as error:
            if fixture is None:
                raise
            raise MechanismDoesNotClose(f"in the fixture '{fixture}': {error}") from error
        stops = tuple(replace(stop, fixture=fixture) for stop in tour.stops)
        stays.append(Stay(replace(tour, stops=stops), begin_s))
        begin_s = (stops[-1].leave_s if stops else begin_s + LEAD_S) + CARRY_S
    return Passage(tuple(stays))
