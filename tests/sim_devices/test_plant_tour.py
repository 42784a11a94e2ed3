"""Driven sessions solved as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from recordings.rig import visits
from sim_devices.plant.creation import make_nature
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.live import make_plant
from sim_devices.plant.session import play
from sim_devices.plant.tour import drive_tour


@pytest.fixture
def tour(arm):
    nature = make_nature(arm, 1)
    return drive_tour(nature, nature.mechanism, visits(arm.plan, 6), arm.plan)


def test_every_sample_closes_the_loop(tour):
    time_s = np.arange(0, tour.stops[-1].leave_s, 0.01)
    variables = tour.variables_at(time_s)
    error, _ = tour.loop.closure(variables, time_s)
    assert np.abs(error).max() < 1e-10
    assert np.abs(np.diff(variables, axis=0)).max() < 0.1


def test_dwells_are_at_rest(tour, arm):
    plan = arm.plan
    for stop in tour.stops:
        rest = tour.variables_at(np.linspace(stop.arrive_s + 1e-9, stop.leave_s - 1e-9, 20))
        np.testing.assert_array_equal(rest, np.broadcast_to(rest[0], rest.shape))
        assert stop.rest_s - stop.arrive_s == pytest.approx(plan.settle)
        assert stop.leave_s - stop.rest_s == pytest.approx(plan.dwell)


def test_the_same_pose_is_the_same_configuration_at_every_visit(tour):
    at = tour.at_stops()
    for pose in range(6):
        same = at[[stop.pose == pose for stop in tour.stops]]
        np.testing.assert_allclose(same, np.broadcast_to(same[0], same.shape), atol=1e-9)


def test_a_path_with_holes_is_an_error_that_names_the_pose(tour):
    torn = tour.knots.copy()
    torn[tour.legs[2].first_knot + 1 :, :5] += 1.0
    with pytest.raises(CannotSimulate, match=f"way to pose {tour.stops[2].pose}"):
        replace(tour, knots=torn).variables_at(np.arange(0, tour.stops[-1].leave_s, 0.01))


def test_in_step_with_a_clock_the_mechanism_goes_to_the_same_places(arm):
    nature = make_nature(arm, 3)
    played = play(nature, 4)
    plant = make_plant(nature)
    time_s = 0.0
    for stop in played.stops[:4]:
        for joint, raw in stop.targets.items():
            plant.command(joint, "position", raw)
        time_s += 4.0
        plant.advance(time_s)
        at = np.searchsorted(played.course.time_s, stop.leave_s) - 1
        for name, column in played.course.value.items():
            joint = arm.mechanism.places.index(arm.channel(name).senses)
            assert plant.variables[joint] == pytest.approx(column[at], abs=1e-8)
