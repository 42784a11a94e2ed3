"""A chain held in one of several fixtures: loads in the fixture's axes, slips and yields in its frame."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parse_rig
from sim_devices.plant.creation import make_nature
from sim_devices.plant.session import play, rests

RIG = """
schema = 1
name = "planar"
gravity_m_per_s2 = [0.0, -10.0, 0.0]
[mechanism]
family = "serial"
closure = { constraint = "hinge" }
[mechanism.tip]
x_m = 0.15
[[mechanism.joint]]
name = "shoulder"
a_m = 0.3
home_deg = 45
mass_kg = 2.0
com_m = [-0.1, 0.02, 0.0]
[[mechanism.joint]]
name = "elbow"
a_m = 0.25
home_deg = -80
mass_kg = 1.5
com_m = [-0.125, 0.0, 0.0]
[[mechanism.joint]]
name = "wrist"
home_deg = -60
mass_kg = 0.5
com_m = [0.05, 0.0, 0.0]
[[mechanism.fixture]]
name = "left"
x_m = 0.38
y_m = 0.05
rz_deg = 30
[[mechanism.fixture]]
name = "right"
x_m = 0.43
y_m = 0.05
[[channel]]
name = "c1"
senses = "shoulder"
gain_deg_per_count = 0.001
[[channel]]
name = "c2"
senses = "elbow"
gain_deg_per_count = 0.001
[[channel]]
name = "c3"
senses = "wrist"
gain_deg_per_count = 0.001
[plan]
mode = "driven"
drives = ["shoulder"]
corners_deg = [[40], [55]]
poses = 4
revisit = { poses = 0, visits = 1 }
"""


def planar(variables):
    """Origin of the endpoint (n, 2) [m] and energy (n,) [J], by hand."""
    absolute = np.cumsum(variables, axis=1)
    at, energy = np.zeros((len(variables), 2)), np.zeros(len(variables))
    for k, (length, mass, com) in enumerate(
        ((0.3, 2.0, (-0.1, 0.02)), (0.25, 1.5, (-0.125, 0)), (0.0, 0.5, (0.05, 0)))
    ):
        along = np.stack([np.cos(absolute[:, k]), np.sin(absolute[:, k])], axis=1)
        aside = np.stack([-along[:, 1], along[:, 0]], axis=1)
        at = at + length * along
        energy += 10.0 * mass * (at + com[0] * along + com[1] * aside)[:, 1]
    return at + 0.15 * along, energy


def described(effect, **values):
    lines = "".join(f"{key} = {value}\n" for key, value in values.items())
    where = "fixture" if effect.startswith("fixture") else "shoulder"
    return parse_rig(RIG + f'[[effect]]\nname = "{effect}"\nwhere = "{where}"\n{lines}')


PLACES = {"left": np.array([0.38, 0.05]), "right": np.array([0.43, 0.05])}
TURNED = {"left": np.deg2rad(30.0), "right": 0.0}


def force_on_fixture(variables):
    """(n, 2) [N] in base axes, by hand: elbow and wrist are free, so moments about both vanish."""
    out = []
    for row in variables:
        absolute = np.cumsum(row)
        along = [np.array([np.cos(a), np.sin(a)]) for a in absolute]
        aside = [np.array([-u[1], u[0]]) for u in along]
        elbow = 0.3 * along[0]
        wrist = elbow + 0.25 * along[1]
        end = wrist + 0.15 * along[2]
        forearm = wrist - 0.125 * along[1] + 0.0 * aside[1]
        hand = wrist + 0.05 * along[2]
        weight = np.array([0.0, -10.0])

        def moment(point, about, force):
            lever = point - about
            return lever[0] * force[1] - lever[1] * force[0]

        # Unknown force f of the fixture on the end: moments about the wrist, and about the elbow.
        rows = [[moment(end, p, e) for e in np.eye(2)] for p in (wrist, elbow)]
        loads = [
            moment(hand, wrist, 0.5 * weight),
            moment(hand, elbow, 0.5 * weight) + moment(forearm, elbow, 1.5 * weight),
        ]
        out.append(-np.linalg.solve(np.array(rows), -np.array(loads)))
    return np.array(out)


@pytest.mark.parametrize("fixture", ["left", "right"])
def test_a_yielding_fixture_lets_the_end_go_with_the_force_on_it(fixture):
    rig = described("fixture-compliance", compliance_m_per_N=1e-4)
    nature = make_nature(rig, 0)
    at = stops(nature, fixture)
    end, _ = planar(at)
    expected = 1e-4 * force_on_fixture(at)
    np.testing.assert_allclose(end - PLACES[fixture], expected, atol=2e-7)
    assert np.abs(expected).max() > 1e-4


@pytest.mark.parametrize("fixture", ["left", "right"])
def test_a_slipped_fixture_is_displaced_in_its_own_axes(fixture):
    rig = described("fixture-slip", x_mm=3.0, at_s=0.0)
    at = stops(make_nature(rig, 0), fixture)
    way = 3e-3 * np.array([np.cos(TURNED[fixture]), np.sin(TURNED[fixture])])
    np.testing.assert_allclose(
        planar(at)[0] - PLACES[fixture], np.tile(way, (len(at), 1)), atol=1e-10
    )


def test_a_yielding_drive_is_behind_by_the_torque_that_lifts_the_energy():
    rig = described("joint-compliance", compliance_rad_per_Nm=1e-3)
    nature, plain = make_nature(rig, 0), make_nature(parse_rig(RIG), 0)
    motor = stops(nature, "right")
    loop, held = plain.loops["right"], np.array([True, False, False])
    link = motor.copy()
    for _ in range(8):
        sides = []
        for step in (1e-5, -1e-5):
            moved, _ = loop.polish(link + np.array([step, 0, 0]), held, np.zeros(len(link)))
            sides.append(planar(moved)[1])
        torque = (sides[0] - sides[1]) / 2e-5
        link[:, 0] = motor[:, 0] - 1e-3 * torque
        link, _ = loop.polish(link, held, np.zeros(len(link)))
    assert np.abs(torque).max() > 1.0
    np.testing.assert_allclose(link[:, 1:], motor[:, 1:], atol=1e-6)


def stops(nature, fixture):
    """(4, 3) joint variables at the stops in a fixture."""
    found = rests(nature)
    half = len(found.coordinates) // 2
    closed = found.coordinates[:half] if fixture == "left" else found.coordinates[half:]
    held = np.array([True, False, False])
    late, left = nature.loops[fixture].polish(closed, held, np.full(len(closed), 100.0))
    assert left.max() < 1e-11
    return late


@pytest.mark.parametrize("wish", ["joint-compliance@shoulder=0.02", "thermal-growth@links=1e-5"])
def test_hidden_effects_play_in_every_fixture(wish):
    rig = parse_rig(RIG)
    plain, played = play(make_nature(rig, 0)), play(make_nature(rig, 0, [wish]))
    assert [stop.fixture for stop in played.stops] == [stop.fixture for stop in plain.stops]
    for at in (200, -1):
        apart = played.course.value["c2"][at] - plain.course.value["c2"][at]
        assert 1e-6 < abs(apart) < 0.02
