"""Speed profiles of drives and hands."""

import numpy as np
import pytest

from sim_devices.plant.motion import RAMP_S, minimum_jerk, move, sampled_course


@pytest.mark.parametrize("start_speed", [0.0, 0.3, -0.5, 0.5])
@pytest.mark.parametrize("target", [1.0, -1.0, 0.01, -0.01, 0.0])
def test_a_move_is_continuous_bounded_and_ends_exactly(target, start_speed):
    profile = move(2.0, 0.0, target, 0.5, start_speed)
    time_s = np.linspace(2.0, profile.end_s + 0.1, 4001)
    where = profile.at(time_s)
    speed = np.gradient(where, time_s)
    assert where[0] == pytest.approx(0.0, abs=1e-12)
    assert where[-1] == target
    assert np.abs(speed).max() <= 0.5 + 1e-6
    assert np.abs(np.gradient(speed, time_s)).max() <= 0.5 / RAMP_S * 1.05
    inside = time_s[1:-1][time_s[1:-1] < profile.end_s - 0.002]
    modelled = [profile.speed_at(float(t)) for t in inside]
    np.testing.assert_allclose(modelled, speed[1 : 1 + len(inside)], atol=5e-3)


def test_a_long_move_takes_its_way_over_its_speed_and_one_ramp():
    assert move(0.0, 0.0, 2.0, 0.5).end_s == pytest.approx(2.0 / 0.5 + RAMP_S)


def test_no_way_takes_no_time():
    profile = move(1.0, 0.3, 0.3, 0.5)
    assert profile.end_s == 1.0
    assert profile.at(np.array([0.0, 1.0, 2.0])).tolist() == [0.3, 0.3, 0.3]


def test_minimum_jerk_starts_and_ends_gently():
    share = minimum_jerk(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]))
    assert share.tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert minimum_jerk(np.array([0.01]))[0] < 1e-4


def test_a_course_knows_its_rates():
    time_s = np.linspace(0, 1, 101)
    course = sampled_course(time_s, {"c": 3 * time_s})
    np.testing.assert_allclose(course.rate["c"], 3.0)
