"""A serial rig in step with a clock: what drives do to it, what it does to drives."""

import numpy as np
import pytest

from sim_devices.plant.creation import make_nature
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.live import make_plant

STEP_S = 0.005


class Session:
    """A plant and its clock."""

    def __init__(self, rig, seed=0):
        self.rig, self.nature = rig, make_nature(rig, seed)
        self.plant = make_plant(self.nature)
        self.time_s = 0.0

    def run(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self.time_s += STEP_S
            self.plant.advance(self.time_s)

    def hold(self, joint):
        self.plant.command(joint, "position", self.plant.sense(self.rig.sensed_by(joint).name))

    def aim(self, joint, degrees):
        channel = self.rig.sensed_by(joint)
        counts = channel.zero_count + np.deg2rad(degrees) / channel.gain.nominal
        self.plant.command(joint, "position", round(counts))

    def degrees(self, joint):
        return np.rad2deg(self.plant.variables[self.rig.mechanism.places.index(joint)])

    def faults(self):
        codes = {joint: self.plant.drive_fault(joint) for joint in self.rig.mechanism.places}
        return {joint: code for joint, code in codes.items() if code}


@pytest.fixture
def session(arm):
    return Session(arm)


@pytest.fixture
def driven(session):
    session.hold("joint5")
    session.hold("joint6")
    return session


def test_two_position_joints_fix_the_pose(driven):
    driven.aim("joint5", 70)
    driven.aim("joint6", -50)
    driven.run(3)
    assert driven.faults() == {}
    assert driven.degrees("joint5") == pytest.approx(70, abs=1e-3)
    assert driven.degrees("joint6") == pytest.approx(-50, abs=0.03)
    first = driven.plant.variables
    error, _ = driven.nature.mechanism.closure(first[None], np.zeros(1))
    assert np.abs(error).max() < 1e-10
    driven.aim("joint5", 50)
    driven.run(1.5)
    driven.aim("joint5", 70)
    driven.run(1.5)
    np.testing.assert_allclose(driven.plant.variables, first, atol=1e-9)


def test_a_move_keeps_to_the_plans_speed_and_ends_at_rest(driven):
    driven.aim("joint5", 80)
    track = []
    for _ in range(200):
        driven.run(STEP_S)
        track.append(driven.degrees("joint5"))
    speeds = np.diff(track) / STEP_S
    assert speeds.max() == pytest.approx(np.rad2deg(driven.rig.plan.move), rel=1e-6)
    assert track[-1] == track[-20]


def test_the_whole_mechanism_rests_between_moves(driven):
    driven.aim("joint5", 70)
    driven.run(2)
    before = driven.plant.variables
    driven.run(2)
    np.testing.assert_array_equal(driven.plant.variables, before)


def test_free_joints_stay_where_they_are(session):
    before = session.plant.variables
    session.run(1)
    np.testing.assert_array_equal(session.plant.variables, before)


def test_one_position_joint_moves_without_fault_and_leaves_the_rest_compliant(session):
    session.hold("joint5")
    session.aim("joint5", 70)
    session.run(1.5)
    assert session.faults() == {}
    assert session.degrees("joint5") == pytest.approx(70, abs=1e-3)
    rested = session.plant.variables
    session.run(1)
    np.testing.assert_array_equal(session.plant.variables, rested)


def test_a_third_position_joint_faults_once_it_is_dragged_along(driven):
    driven.hold("joint1")
    driven.run(1)
    assert driven.faults() == {}
    driven.aim("joint5", 40)
    driven.run(3)
    assert driven.faults() == {"joint1": 0x8611}
    assert driven.degrees("joint5") == pytest.approx(40, abs=1e-3)


def test_a_third_position_joint_faults_when_it_is_told_to_move_alone(driven):
    driven.hold("joint1")
    driven.aim("joint1", driven.degrees("joint1") + 20)
    driven.run(1)
    assert driven.faults() == {"joint1": 0x8611}


def test_a_fault_stays_until_the_drive_is_off(driven):
    driven.hold("joint1")
    driven.aim("joint1", 0)
    driven.run(1)
    driven.hold("joint1")
    assert driven.plant.drive_fault("joint1") == 0x8611
    driven.plant.command("joint1", "off", 0)
    assert driven.plant.drive_fault("joint1") == 0


def test_a_target_beyond_the_joints_limits_is_refused(driven):
    driven.run(0.5)
    before = driven.plant.variables
    driven.aim("joint5", 175)
    assert driven.plant.drive_fault("joint5") == 0x8612
    driven.run(1)
    np.testing.assert_array_equal(driven.plant.variables, before)


def test_out_of_reach_the_mechanism_blocks_and_the_drive_faults(driven):
    driven.aim("joint5", -160)
    driven.run(6)
    assert driven.faults() == {"joint5": 0x8611}
    assert driven.nature.mechanism.within_limits(driven.plant.variables)


def test_a_new_target_on_the_way_takes_effect_at_once(driven):
    driven.aim("joint5", 80)
    driven.run(0.2)
    driven.aim("joint5", 50)
    driven.run(2)
    assert driven.faults() == {}
    assert driven.degrees("joint5") == pytest.approx(50, abs=1e-3)


def test_sensors_read_what_joints_do(driven):
    driven.run(0.1)
    raw = [driven.plant.sense("q3") for _ in range(400)]
    truth = driven.nature.truth.parameters
    expected = 200000 + np.deg2rad(driven.degrees("joint3")) / truth["q3.gain"]
    assert np.mean(raw) == pytest.approx(expected, abs=0.2)
    assert np.std(raw) == pytest.approx(1.04, abs=0.12)


def test_pushing_moves_nothing_and_unknown_modes_are_errors(session):
    before = session.plant.variables
    session.plant.command("joint1", "torque", 500)
    session.run(0.1)
    np.testing.assert_array_equal(session.plant.variables, before)
    with pytest.raises(CannotSimulate, match="unknown mode 'fly'"):
        session.plant.command("joint1", "fly", 0)
    with pytest.raises(CannotSimulate, match="'hinge' cannot be held"):
        session.plant.command("hinge", "position", 0)


def test_time_never_goes_back(driven):
    driven.aim("joint5", 70)
    driven.run(0.3)
    before = driven.plant.variables
    driven.plant.advance(0.1)
    np.testing.assert_array_equal(driven.plant.variables, before)


def test_a_long_pause_between_two_calls_is_bridged(driven):
    driven.aim("joint5", 75)
    driven.plant.advance(10.0)
    assert driven.degrees("joint5") == pytest.approx(75, abs=1e-3)
    assert driven.faults() == {}
