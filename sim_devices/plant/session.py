"""A whole session of a rig's plan, played at once: what every sensed place does, sample by sample.

The vectorised face of nature. Its other face, in step with a clock, is the plant that the
virtual devices sense (`sim_devices.plant.live`); both move by the same laws.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recordings.rig import Plan, visits
from sim_devices.plant.effects.effect import Rests
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.fixtures import Passage, drive_through
from sim_devices.plant.hand import Hand
from sim_devices.plant.loop import Loop
from sim_devices.plant.motion import Course, sampled_course
from sim_devices.plant.nature import Nature
from sim_devices.plant.plate import Plate
from sim_devices.plant.quaternion import Array
from sim_devices.plant.stop import LEAD_S, Stop


@dataclass(frozen=True, slots=True)
class Played:
    """A session as it went.

    Attributes:
        course: of every channel, at the plan's sample rate from the start to the last stop's end.
        stops: in order of time.
    """

    course: Course
    stops: tuple[Stop, ...]


def plan_of(nature: Nature) -> Plan:
    """The plan of a rig; raises CannotSimulate where it has none."""
    if nature.rig.plan is None:
        raise CannotSimulate(f"the rig '{nature.rig.name}' has no [plan]; a session needs one")
    return nature.rig.plan


def play(nature: Nature, poses: int | None = None) -> Played:
    """Play the plan of a rig.

    Args:
        nature: the rig as it really is.
        poses: number of distinct poses, in place of the plan's own.

    Raises:
        CannotSimulate: no plan, or one that this mechanism cannot carry out.
        MechanismDoesNotClose: the loop does not close.
    """
    plan, mechanism = plan_of(nature), nature.mechanism
    if isinstance(mechanism, Loop):
        passage = _driven(nature, poses)
        stops = passage.stops
        time_s = _samples(plan, stops)
        places = np.vstack(
            [
                _joints_and_markers(nature, loop, variables, part_s)
                for loop, part_s, variables in passage.pieces(time_s)
            ]
        )
    else:
        hand = scripted_hand(nature, mechanism, poses)
        stops = hand.round(0, LEAD_S)
        time_s = _samples(plan, stops)
        places = legs_and_markers(nature, mechanism, *hand.plate_at(time_s), time_s)
    return Played(sampled_course(time_s, nature.by_channel(places)), stops)


def rests(nature: Nature, poses: int | None = None) -> Rests:
    """Every stop that the plan reaches; raises as `play` does."""
    mechanism = nature.mechanism
    if isinstance(mechanism, Loop):
        passage = _driven(nature, poses)
        times, places, coordinates = [], [], []
        for stay in passage.stays:
            tour = stay.tour
            times.append(np.array([stop.arrive_s for stop in tour.stops if not stop.faults]))
            coordinates.append(tour.at_stops())
            places.append(_joints_and_markers(nature, tour.loop, coordinates[-1], times[-1]))
        return Rests(
            np.concatenate(times),
            nature.by_channel(np.vstack(places)),
            np.vstack(coordinates),
            passage.stops[-1].leave_s if passage.stops else LEAD_S,
        )
    hand = scripted_hand(nature, mechanism, poses)
    stops = hand.round(0, LEAD_S)
    arrived = np.array([stop.arrive_s for stop in stops])
    pose = hand.plate_at(arrived)
    value = nature.by_channel(legs_and_markers(nature, mechanism, *pose, arrived))
    return Rests(arrived, value, np.hstack(pose), stops[-1].leave_s if stops else LEAD_S)


def resting(nature: Nature, poses: int | None = None) -> Mapping[str, Array]:
    """By channel, its value at every stop that the plan reaches [rad or m]; raises as `play` does."""
    return rests(nature, poses).value


def legs_and_markers(
    nature: Nature, plate: Plate, turned: Array, shifted: Array, time_s: Array
) -> Array:
    """(n, places) what a platform's places do, at plate turns (n, 4) and shifts (n, 3) [m]."""
    legs = plate.readings(turned, shifted, time_s)
    return np.hstack([legs, nature.trackers.seen(turned, shifted)])


def _joints_and_markers(nature: Nature, loop: Loop, variables: Array, time_s: Array) -> Array:
    """(n, places) what a chain's places do, at joint variables (n, J)."""
    if not nature.rig.trackers:
        return variables
    return np.hstack([variables, nature.trackers.seen(*loop.end(variables, time_s))])


def scripted_hand(nature: Nature, plate: Plate, poses: int | None = None) -> Hand:
    """The hand that moves a platform by its plan; raises CannotSimulate for a driven plan."""
    plan = plan_of(nature)
    if plan.mode != "by-hand":
        raise CannotSimulate(
            "the plan drives joints, but a platform has none; give it a by-hand plan"
        )
    spans = []
    for leg in nature.rig.mechanism.places:
        channel = nature.rig.sensed_by(leg)
        spans.append(nature.sensors[channel.name].span if channel else None)
    return Hand(plan, visits(plan, poses), plate, spans, nature.truth.seed)


def _driven(nature: Nature, poses: int | None) -> Passage:
    plan = plan_of(nature)
    if plan.mode != "driven":
        raise CannotSimulate(
            "the plan is by hand, but only a platform is simulated so; a chain of joints needs a "
            "driven plan"
        )
    return drive_through(nature, plan, poses)


def _samples(plan: Plan, stops: tuple[Stop, ...]) -> Array:
    end = stops[-1].leave_s if stops else LEAD_S
    return np.arange(int(np.ceil(end * plan.sample)) + 1) / plan.sample
