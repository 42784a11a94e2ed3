"""Loads of mechanisms that stand still, against the energy that they would have to change."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parse_rig, rig_text
from sim_devices.plant.chain import chain_geometry, displaced
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.loads import Loads, loads_of
from sim_devices.plant.loop import Loop
from sim_devices.plant.plate import Plate, plate_geometry
from sim_devices.plant.quaternion import IDENTITY, about, product, turn
from sim_devices.plant.session import rests

STEP = 1e-5


def turning_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def turning_x(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def shifting(x, y, z):
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


def arm_energy(rig, values, variables):
    """Potential energy [J] of the links in the base frame, by 4 x 4 matrices from the base on."""
    joints = rig.mechanism.joints
    first = 1 + rig.mechanism.places.index(rig.mechanism.base)
    frame, energy = np.eye(4), 0.0
    for joint, variable in list(zip(joints, variables, strict=True))[first:]:
        theta, s, a, alpha = (
            values[f"{joint.name}.{p}"] for p in ("theta_offset", "s", "a", "alpha")
        )
        frame = frame @ turning_z(theta + variable) @ shifting(a, 0, s) @ turning_x(alpha)
        centre = (frame @ np.array([*joint.com, 1.0]))[:3]
        energy -= joint.mass * np.array(rig.gravity) @ centre
    return energy


@pytest.fixture(scope="module")
def standing():
    """The arm, its true parameters, its loop, closed configurations and their loads."""
    text, source = rig_text("arm")
    rig = parse_rig(text, source)
    nature = make_nature(rig, 3)
    at = rests(nature, 4).coordinates
    values = nature.truth.parameters
    geometry = chain_geometry(rig.mechanism, values)
    return rig, values, geometry, at, loads_of(rig, values).of_chain(geometry, at)


def energies(rig, values, geometry, start, held):
    """Energy of the loop closed from ``start`` (n, J), the drives as they are."""
    loop = Loop(rig.mechanism, geometry)
    closed, left = loop.polish(start, held, np.zeros(len(start)))
    assert left.max() < 1e-11
    return np.array([arm_energy(rig, values, row) for row in closed])


def test_drives_work_against_the_energy_of_the_loop(standing):
    rig, values, geometry, at, loads = standing
    held = np.isin(rig.mechanism.places, rig.plan.drives)
    for joint in np.flatnonzero(held):
        ahead, back = at.copy(), at.copy()
        ahead[:, joint] += STEP
        back[:, joint] -= STEP
        difference = energies(rig, values, geometry, ahead, held) - energies(
            rig, values, geometry, back, held
        )
        np.testing.assert_allclose(loads.torque[:, joint], difference / (2 * STEP), rtol=1e-5)
    assert np.all(loads.torque[:, ~held] == 0.0)
    assert np.abs(loads.torque[:, held]).min() > 0.1


def test_moving_the_fixture_works_against_the_energy_of_the_loop(standing):
    rig, values, geometry, at, loads = standing
    held = np.isin(rig.mechanism.places, rig.plan.drives)
    for axis in np.eye(3):
        for kind, told in (("shift", loads.force), ("turn", loads.moment)):
            moved = []
            for step in (STEP, -STEP):
                turned = about(axis, np.array(step)) if kind == "turn" else IDENTITY
                shift = step * axis if kind == "shift" else np.zeros(3)
                there = displaced(geometry, turned, shift)
                moved.append(energies(rig, values, there, at, held))
            # The fixture pushes the chain up that energy; the chain pushes back.
            np.testing.assert_allclose(
                told @ axis, -(moved[0] - moved[1]) / (2 * STEP), rtol=1e-4, atol=1e-6
            )


def test_a_free_hinge_carries_no_moment(standing):
    _, _, _, _, loads = standing
    # The chain starts with the hinge, about z.
    np.testing.assert_allclose(loads.moment[:, 2], 0.0, atol=1e-9)
    assert np.abs(loads.moment[:, :2]).max() > 0.1


def test_an_open_arm_is_carried_by_its_drives():
    text = """
schema = 1
name = "two-links"
gravity_m_per_s2 = [0, -10, 0]
[mechanism]
family = "serial"
closure = { constraint = "open" }
[[mechanism.joint]]
name = "shoulder"
convention = "urdf"
z_m = 0.3
mass_kg = 1
com_m = [0.5, 0, 0]
[[mechanism.joint]]
name = "elbow"
convention = "urdf"
x_m = 1
mass_kg = 2
com_m = [0.25, 0, 0]
[[channel]]
name = "c1"
senses = "shoulder"
gain_deg_per_count = 0.01
[[channel]]
name = "c2"
senses = "elbow"
gain_deg_per_count = 0.01
[plan]
mode = "driven"
drives = ["shoulder", "elbow"]
targets_deg = [[0, 0], [0, 90]]
"""
    rig = parse_rig(text)
    values = make_nature(rig, 0).truth.parameters
    at = np.array([[0.0, 0.0], [0.0, np.pi / 2], [np.pi / 2, 0.0]])
    loads = loads_of(rig, values).of_chain(chain_geometry(rig.mechanism, values), at)
    np.testing.assert_allclose(loads.torque, [[30, 5], [25, 0], [0, 0]], atol=1e-9)
    np.testing.assert_allclose(loads.force, 0.0)


@pytest.fixture(scope="module", params=["pivoted", "free", "point"])
def stood(request):
    """A platform, its plate, poses and loads; points of the shoulder, legs enough for each kind."""
    text, source = rig_text("shoulder" if request.param == "pivoted" else "stewart")
    if request.param != "pivoted":
        text = text.replace('plate = "free"', f'plate = "{request.param}"\nplate_mass_kg = 4.0\n'
                            "plate_com_m = [0.1, 0.05, 0.02]")  # fmt: skip
        text = text.replace(
            'name = "stewart"', 'name = "stewart"\ngravity_m_per_s2 = [1, 2, -9]', 1
        )
    rig = parse_rig(text, source)
    values = make_nature(rig, 1).truth.parameters
    geometry = plate_geometry(rig.mechanism, values)
    plate = Plate(rig.mechanism, geometry)
    rng = np.random.default_rng(0)
    n = 5
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turned = product(about(axis, rng.uniform(0, 0.3, n)), plate.neutral_turn)
    if request.param == "point":
        turned = np.broadcast_to(IDENTITY, (n, 4))
    shifted = plate.neutral_shift + 0.02 * rng.standard_normal((n, 3)) * plate.shifts
    loads = loads_of(rig, values).of_plate(geometry, np.hstack([turned, shifted]))
    return rig, plate, geometry, turned, shifted, loads


def test_legs_work_against_the_energy_of_the_plate(stood):
    rig, plate, _, turned, shifted, loads = stood
    mechanism = rig.mechanism

    def work(turned, shifted):
        """Energy, and that of the legs at their tensions now."""
        centre = turn(turned, np.array(mechanism.plate_com)) + shifted
        energy = -mechanism.plate_mass * centre @ np.array(rig.gravity)
        lengths = plate.lengths(turned, shifted, np.zeros(len(turned)))
        return energy + (loads.tension * lengths).sum(axis=1)

    for axis in np.eye(3):
        if plate.turns:
            ahead = work(product(about(axis, np.array(STEP)), turned), shifted)
            back = work(product(about(axis, np.array(-STEP)), turned), shifted)
            np.testing.assert_allclose((ahead - back) / (2 * STEP), 0.0, atol=1e-6)
        moved = work(turned, shifted + STEP * axis) - work(turned, shifted - STEP * axis)
        # A pivot bears what the legs leave: it pushes the plate, and the plate pushes it.
        np.testing.assert_allclose(-loads.force @ axis, moved / (2 * STEP), atol=1e-6)
    assert np.abs(loads.tension).max() > 1.0


def test_redundant_legs_share_with_the_least_energy(stood):
    _, _, geometry, turned, _, loads = stood
    arm = turn(turned[:, None], geometry.plate)
    force, moment = loads.along, np.cross(arm, loads.along)
    for k in range(len(turned)):
        kind = stood[0].mechanism.plate
        rows = {"point": force[k], "pivoted": moment[k], "free": np.hstack([force[k], moment[k]])}
        useless = np.linalg.svd(rows[kind].T)[2][rows[kind].shape[1] :]
        np.testing.assert_allclose(useless @ loads.tension[k], 0.0, atol=1e-6)


def test_weights_scale_the_loads(stood):
    rig, _, geometry, turned, shifted, loads = stood
    heavier = rig.model_copy(
        update={"mechanism": rig.mechanism.model_copy(
            update={"plate_mass": 2 * rig.mechanism.plate_mass})}
    )  # fmt: skip
    twice = loads_of(heavier, {}).of_plate(geometry, np.hstack([turned, shifted]))
    np.testing.assert_allclose(twice.tension, 2 * loads.tension, rtol=1e-9)


def test_under_gravity_compensation_each_drive_raises_what_its_joint_moves(standing):
    rig, values, geometry, at, _ = standing
    mechanism = rig.mechanism.model_copy(update={"standing": "gravity-compensated"})
    balanced = rig.model_copy(update={"mechanism": mechanism, "plan": None})
    loads = loads_of(balanced, values).of_chain(geometry, at)
    for joint in range(at.shape[1]):
        step = STEP * np.eye(at.shape[1])[joint]
        raised = [arm_energy(rig, values, row + step) for row in at]
        lowered = [arm_energy(rig, values, row - step) for row in at]
        difference = (np.array(raised) - lowered) / (2 * STEP)
        np.testing.assert_allclose(loads.torque[:, joint], difference, atol=1e-6)
    assert np.abs(loads.torque).max() > 1.0
    assert not loads.force.any()
    assert not loads.moment.any()
    assert Loads.known(balanced)
    assert not Loads.known(rig.model_copy(update={"plan": None}))
