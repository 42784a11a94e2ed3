"""Plates on legs and the hand that moves them."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recordings.rig import load_rig, parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.live import make_plant
from sim_devices.plant.quaternion import angle_between, axes, between, cross, product, turn
from sim_devices.plant.session import play, scripted_hand


def test_quaternions_agree_with_rotations_of_scipy():
    rng = np.random.default_rng(2)
    p, q = (r.as_quat(scalar_first=True) for r in (Rotation.random(5, rng=rng) for _ in range(2)))
    P, Q = (Rotation.from_quat(r, scalar_first=True) for r in (p, q))
    v, u = rng.standard_normal((2, 5, 3))
    np.testing.assert_allclose(turn(p, v), P.apply(v), atol=1e-14)
    np.testing.assert_allclose(turn(product(p, q), v), (P * Q).apply(v), atol=1e-14)
    np.testing.assert_allclose(axes(p), P.as_matrix().transpose(0, 2, 1), atol=1e-14)
    np.testing.assert_allclose(cross(u, v), np.cross(u, v), atol=1e-14)
    np.testing.assert_allclose(angle_between(p, q), (P.inv() * Q).magnitude(), atol=1e-7)
    halfway = between(p[0], q[0], np.array([0.5]))[0]
    whole = angle_between(p[0], q[0])
    assert angle_between(p[0], halfway) == pytest.approx(whole / 2)


def test_leg_lengths_are_distances_between_points(shoulder):
    nature = make_nature(shoulder, 3)
    value = nature.truth.parameters
    R = Rotation.from_euler("xyz", [20, -10, 35], degrees=True)
    q = R.as_quat(scalar_first=True)

    def at(point):
        return np.array([value[f"{point}.{axis}"] for axis in "xyz"])

    expected = [
        np.linalg.norm(at(leg.base) - R.apply(at(leg.plate))) for leg in shoulder.mechanism.legs
    ]
    lengths = nature.mechanism.lengths(q[None], np.zeros((1, 3)), np.zeros(1))
    np.testing.assert_allclose(lengths[0], expected, atol=1e-15)


@pytest.fixture
def round_of_hand(shoulder):
    nature = make_nature(shoulder, 1)
    hand = scripted_hand(nature, nature.mechanism)
    stops = hand.round(0, 0.5)
    rests = np.array([(stop.arrive_s, stop.leave_s) for stop in stops])
    turns, _ = hand.plate_at(rests.ravel())
    return shoulder.plan, stops, hand, turns.reshape(len(stops), 2, 4)


def test_the_hand_keeps_to_tilt_and_swivel(round_of_hand):
    plan, _, _, turns = round_of_hand
    up = turn(turns[:, 0], np.array([0.0, 0.0, 1.0]))
    tilt = np.arccos(np.clip(up[:, 2], -1, 1))
    assert tilt.max() < plan.tilt + np.deg2rad(3)
    assert tilt.max() > 0.8 * plan.tilt


def test_the_hand_rests_long_enough_and_irregularly(round_of_hand):
    plan, stops, _, turns = round_of_hand
    np.testing.assert_allclose(turns[:, 0], turns[:, 1], atol=1e-12)
    rest = np.array([stop.leave_s - stop.rest_s for stop in stops])
    assert rest.min() >= plan.dwell
    assert rest.std() > 0.05
    assert all(a.leave_s == b.start_s for a, b in pairwise(stops))


def test_the_hand_comes_back_nearly(round_of_hand):
    _, stops, _, turns = round_of_hand
    first = {stop.pose: turns[k, 0] for k, stop in enumerate(stops) if stop.visit == 0}
    off = [
        float(angle_between(turns[k, 0], first[stop.pose]))
        for k, stop in enumerate(stops)
        if stop.visit > 0
    ]
    assert len(off) == 20
    assert min(off) > 1e-4
    assert max(off) < np.deg2rad(2.5)


def test_the_hand_moves_no_faster_than_the_plan(round_of_hand):
    plan, stops, hand, _ = round_of_hand
    time_s = np.arange(0.0, stops[20].leave_s, 0.01)
    turns, _ = hand.plate_at(time_s)
    speeds = angle_between(turns[1:], turns[:-1]) / 0.01
    assert speeds.max() < plan.move * 1.01


def test_legs_stay_within_their_sensors(shoulder):
    for seed in range(3):
        nature = make_nature(shoulder, seed)
        played = play(nature)
        for name, sensor in nature.sensors.items():
            low, high = sensor.span
            assert low < played.course.value[name].min()
            assert played.course.value[name].max() < high


def test_a_hand_that_finds_no_room_says_so(shoulder):
    text = (
        rig_text("shoulder")[0]
        .replace("neutral = ", "#")
        .replace("nominal = 97.0", "nominal = 400")
    )
    nature = make_nature(parse_rig(text), 0)
    with pytest.raises(CannotSimulate, match="lower tilt and swivel"):
        play(nature)


@pytest.mark.parametrize(("plate", "turns"), [("free", True), ("point", False)])
def test_free_and_point_plates_shift(plate, turns):
    text = rig_text("shoulder")[0].replace('plate = "pivoted"', f'plate = "{plate}"')
    nature = make_nature(parse_rig(text), 0)
    hand = scripted_hand(nature, nature.mechanism)
    stops = hand.round(0, 0.0)
    turned, shifted = hand.plate_at(np.array([stop.rest_s for stop in stops]))
    assert np.ptp(shifted, axis=0).min() > 0.01
    assert (np.abs(angle_between(turned, turned[:1])).max() > 0.1) == turns


def test_live_the_person_begins_once_somebody_looks(shoulder):
    plant = make_plant(make_nature(shoulder, 0))
    plant.advance(20.0)
    before = [plant.sense(f"d{k}") for k in (1, 2, 3, 4)]
    plant.advance(20.4)
    rested = np.array([[plant.sense(f"d{k}") for k in (1, 2, 3, 4)] for _ in range(50)])
    assert np.abs(rested.mean(axis=0) - before).max() < 25
    moved = []
    for k in range(400):
        plant.advance(20.5 + k * 0.05)
        moved.append([plant.sense(f"d{leg}") for leg in (1, 2, 3, 4)])
    assert np.ptp(np.array(moved), axis=0).min() > 200


def test_live_the_hand_goes_on_after_its_first_round(shoulder):
    plant = make_plant(make_nature(shoulder, 0))
    plant.sense("d1")
    end = scripted_hand(make_nature(shoulder, 0), make_nature(shoulder, 0).mechanism)
    leave_s = end.round(0, 0.5)[-1].leave_s
    readings = []
    for k in range(200):
        plant.advance(leave_s + 1.0 + k * 0.1)
        readings.append(plant.sense("d1"))
    assert np.ptp(readings) > 200


def test_live_and_at_once_move_alike(shoulder):
    nature = make_nature(shoulder, 5)
    played = play(nature)
    plant = make_plant(nature)
    plant.sense("d1")
    for k in (100, 700, 1500):
        plant.advance(float(played.course.time_s[k]))
        mean = np.mean([plant.sense("d2") for _ in range(400)])
        sensor = nature.rig.channel("d2")
        expected = played.course.value["d2"][k] - nature.truth.parameters["d2.offset"]
        assert mean - sensor.zero_count == pytest.approx(expected / sensor.gain.nominal, abs=1.5)


def test_a_platform_has_no_drives():
    plant = make_plant(make_nature(load_rig("shoulder"), 0))
    with pytest.raises(CannotSimulate, match="no drives"):
        plant.command("leg1", "free", 0)
