"""Loads by virtual work against total energy, and against a four-bar linkage cut free by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from recordings.rig import Rig, SerialMechanism, load_rig, parameters, parse_rig
from solver.mechanism.model import imperfections, mechanism_model
from solver.mechanism.platform import PlatformModel
from solver.mechanism.statics import loads, why_unloaded

Array = np.ndarray


def turn(axis: int, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out = np.eye(4)
    out[i, i], out[j, j], out[i, j], out[j, i] = c, c, -s, s
    return out


def shift(axis: int, size: float) -> Array:
    out = np.eye(4)
    out[axis, 3] = size
    return out


def energy(rig: Rig, u: Array, tilts: dict[str, tuple[float, float]] | None = None) -> float:
    """V [J] of one pose, by plain matrices, gravity in the base frame; joints may tilt about x, then y."""
    mechanism = rig.mechanism
    assert isinstance(mechanism, SerialMechanism)
    assert rig.gravity is not None
    frames = [np.eye(4)]
    for joint, variable in zip(mechanism.joints, u, strict=False):
        a, s, alpha = joint.a.nominal, joint.s.nominal, joint.alpha.nominal
        tilt = (tilts or {}).get(joint.name, (0.0, 0.0))
        step = turn(0, tilt[0]) @ turn(1, tilt[1]) @ turn(2, joint.theta_offset.nominal + variable)
        frames.append(frames[-1] @ step @ shift(2, s) @ shift(0, a) @ turn(0, alpha))
    base = 0 if mechanism.base is None else mechanism.places.index(mechanism.base) + 1
    to_base = np.linalg.inv(frames[base])
    out = 0.0
    for joint, frame in zip(mechanism.joints, frames[1:], strict=True):
        if joint.mass and joint.com is not None:
            centre = to_base @ frame @ np.array([*joint.com, 1.0])
            out -= joint.mass * float(np.array(rig.gravity) @ centre[:3])
    return out


def closed(
    rig: Rig,
    fixed: dict[int, float],
    start: Array,
    moved: Array,
    tilts: dict[str, tuple[float, float]] | None = None,
) -> Array:
    """One pose (U,) with the coordinates ``fixed``, the mount displaced by ``moved`` (3,) [m], joints tilted."""
    table = parameters(rig)
    names = imperfections(rig)
    x = np.array([p.nominal for p in table] + [0.0] * len(names))
    x[len(table) : len(table) + 3] = moved
    for joint, tilt in (tilts or {}).items():
        for k, size in enumerate(tilt, 1):
            x[len(table) + names.index(f"{joint}.tilt_{k}")] = size
    model = mechanism_model(rig, table, imperfect=True)
    u = start.copy()
    u[list(fixed)] = list(fixed.values())
    free = [k for k in range(len(u)) if k not in fixed]
    for _ in range(30):
        at = model.linearise(u[None], x, np.zeros((len(x), 0)))
        step = np.linalg.lstsq(at.closure_by_coordinates[0][:, free], -at.closure[0], rcond=1e-9)[0]
        u[free] += step
    assert np.abs(at.closure).max() < 1e-12
    return u


def nominal(rig: Rig) -> Array:
    return np.array([p.nominal for p in parameters(rig)])


def homes(rig: Rig) -> Array:
    mechanism = rig.mechanism
    assert isinstance(mechanism, SerialMechanism)
    return np.array([joint.home.nominal for joint in mechanism.joints])


def held(rig: Rig, *names: str) -> Array:
    return np.array([[place in names for place in rig.mechanism.places]])


def heavy_before_base(rig: Rig) -> Rig:
    """The arm with its base three joints later and masses on the links before it."""
    mechanism = rig.mechanism
    assert isinstance(mechanism, SerialMechanism)
    return rig.model_copy(update={"mechanism": mechanism.model_copy(update={"base": "joint3"})})


@pytest.mark.parametrize("before", [False, True])
def test_drives_and_fixture_do_the_work_that_raises_the_links(before: bool) -> None:
    rig = load_rig("arm")
    rig = heavy_before_base(rig) if before else rig
    drives = {5: np.deg2rad(50.0), 6: np.deg2rad(-20.0)}
    u = closed(rig, drives, homes(rig), np.zeros(3))
    found = loads(rig, u[None], nominal(rig), held(rig, "joint5", "joint6"))
    assert found.torque is not None
    assert found.force is not None
    assert np.flatnonzero(found.torque[0]).tolist() == [5, 6]
    step = 1e-5
    for joint, angle in drives.items():
        ends = [closed(rig, drives | {joint: angle + s}, u, np.zeros(3)) for s in (step, -step)]
        work = (energy(rig, ends[0]) - energy(rig, ends[1])) / (2 * step)
        assert found.torque[0, joint] == pytest.approx(work, abs=1e-6)
    if before:
        return  # the plain matrices above have no mount; links before the base ride on it
    for axis in range(3):
        ends = [closed(rig, drives, u, s * step * np.eye(3)[axis]) for s in (1, -1)]
        raised = (energy(rig, ends[0]) - energy(rig, ends[1])) / (2 * step)
        assert found.force[0, axis] == pytest.approx(-raised, abs=1e-5)


_FOUR_BAR = """
schema = 1
name = "four-bar"
gravity_m_per_s2 = [0.6, -9.81, 0.0]
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "crank"
a_m = 0.2
mass_kg = 1.0
com_m = [-0.1, 0.02, 0]
home_deg = 60
[[mechanism.joint]]
name = "coupler"
a_m = 0.5
mass_kg = 2.0
com_m = [-0.2, 0.05, 0]
home_deg = -40
[[mechanism.joint]]
name = "rocker"
a_m = 0.4
mass_kg = 1.5
com_m = [-0.25, -0.03, 0]
home_deg = -100
[[mechanism.joint]]
name = "ground"
a_m = -0.6
home_deg = 80
[[channel]]
name = "q"
senses = "crank"
gain_deg_per_count = 0.01
"""


def test_a_four_bar_cut_free_by_hand_carries_the_same() -> None:
    rig = parse_rig(_FOUR_BAR)
    angle = 1.1
    crank = 0.2 * np.array([np.cos(angle), np.sin(angle)])
    # The rocker's ground pivot lies at (0.6, 0) of the base; its tip is where two circles meet.
    ground = np.array([0.6, 0.0])
    apart = ground - crank
    d = float(np.linalg.norm(apart))
    along = (0.5**2 - 0.4**2 + d**2) / (2 * d)
    up = np.array([-apart[1], apart[0]]) / d
    tip = crank + along * apart / d + np.sqrt(0.5**2 - along**2) * up
    pins = [np.zeros(2), crank, tip, ground]
    headings = [np.arctan2(*(b - a)[::-1]) for a, b in pairwise(pins)]
    u = np.array([headings[0], headings[1] - headings[0], headings[2] - headings[1], 0.0])
    u[3] = -headings[2]
    table = nominal(rig)
    model = mechanism_model(rig, parameters(rig))
    closure = model.linearise(u[None], table, np.zeros((len(table), 0))).closure
    assert np.abs(closure).max() < 1e-9

    # Free bodies: pin forces F_k on body k from the pin before it (8 numbers), torque on the crank.
    gravity = np.array([0.6, -9.81])
    masses = [1.0, 2.0, 1.5]
    coms = [[-0.1, 0.02], [-0.2, 0.05], [-0.25, -0.03]]
    rows, right = np.zeros((9, 9)), np.zeros(9)
    for body in range(3):
        c, s = np.cos(headings[body]), np.sin(headings[body])
        centre = pins[body + 1] + np.array([[c, -s], [s, c]]) @ coms[body]
        for axis in range(2):
            rows[3 * body + axis, 2 * body + axis] = 1.0
            rows[3 * body + axis, 2 * (body + 1) + axis] = -1.0
            right[3 * body + axis] = -masses[body] * gravity[axis]
        x, y = pins[body] - pins[body + 1]
        rows[3 * body + 2, 2 * body : 2 * body + 2] = [-y, x]  # moments about the pin behind
        weight = masses[body] * gravity
        arm = centre - pins[body + 1]
        right[3 * body + 2] = -(arm[0] * weight[1] - arm[1] * weight[0])
    rows[2, 8] = 1.0
    solved = np.linalg.solve(rows, right)

    found = loads(rig, u[None], table, held(rig, "crank"))
    assert found.torque is not None
    np.testing.assert_allclose(found.torque[0], [solved[8], 0, 0, 0], atol=1e-9)
    # Across the plane the pins may brace each other: the force on the ground is not known.
    assert found.force is None
    assert "braced" in found.why


def test_legs_and_pivot_hold_the_plate() -> None:
    rig = load_rig("shoulder")
    model = PlatformModel.of(rig)
    u = np.random.default_rng(1).uniform(-0.3, 0.3, (5, 3))
    x = nominal(rig)
    found = loads(rig, u, x, None)
    assert found.torque is not None
    assert found.force is not None
    mechanism = rig.mechanism
    index = {p.name: x[i] for i, p in enumerate(parameters(rig))}
    at = {
        name.rpartition(".")[0]: np.array([index[f"{name.rpartition('.')[0]}.{a}"] for a in "xyz"])
        for name in index
        if name[0] in "AB"
    }
    rotation, _ = model.plate_pose(u)
    weight = 1.5 * np.array([0.0, 0.0, -9.81])
    for pose in range(5):
        force, moment = weight.copy(), np.cross(rotation[pose] @ [0.02, 0.01, 0.09], weight)
        stretch = []
        for leg, tension in zip(mechanism.legs, found.torque[pose], strict=True):
            arm = rotation[pose] @ at[leg.plate]
            pull = tension * (at[leg.base] - arm) / np.linalg.norm(at[leg.base] - arm)
            force, moment = force + pull, moment + np.cross(arm, pull)
            stretch.append(np.cross(arm, pull / tension))
        np.testing.assert_allclose(moment, 0.0, atol=1e-9)
        np.testing.assert_allclose(found.force[pose], force, atol=1e-9)
        # Equal legs share: nothing of the tensions lies in what the plate does not feel.
        idle = np.linalg.svd(np.array(stretch).T)[2][-1]
        assert abs(idle @ found.torque[pose]) < 1e-9


def test_what_is_not_determined_is_said_in_words() -> None:
    rig = load_rig("arm")
    drives = {5: np.deg2rad(50.0), 6: np.deg2rad(-20.0)}
    u = closed(rig, drives, homes(rig), np.zeros(3))[None]
    x = nominal(rig)
    assert "brace each other" in loads(rig, u, x, held(rig, "joint4", "joint5", "joint6")).why
    assert "would fall" in loads(rig, u, x, held(rig, "joint5")).why
    assert "which joints" in loads(rig, u, x, None).why
    assert "gravity_m_per_s2" in str(why_unloaded(rig.model_copy(update={"gravity": None})))
    stewart = load_rig("stewart")
    assert (
        why_unloaded(stewart) is None
        or loads(stewart, np.zeros((1, 6)), nominal(stewart), None).why
    )


def test_several_sets_of_drives_are_told_apart() -> None:
    rig = load_rig("arm")
    u = closed(rig, {5: np.deg2rad(50.0), 6: np.deg2rad(-20.0)}, homes(rig), np.zeros(3))
    one, other = held(rig, "joint5", "joint6"), held(rig, "joint4", "joint6")
    x = nominal(rig)
    both = loads(rig, np.stack([u, u]), x, np.concatenate([one, other]))
    assert both.torque is not None
    for row, alone in enumerate((one, other)):
        torque = loads(rig, u[None], x, alone).torque
        assert torque is not None
        np.testing.assert_allclose(both.torque[row], torque[0], atol=1e-9)


def compensated(rig: Rig) -> Rig:
    mechanism = rig.mechanism.model_copy(update={"standing": "gravity-compensated"})
    return rig.model_copy(update={"mechanism": mechanism})


def test_bearings_do_the_work_that_a_tilt_needs() -> None:
    rig = load_rig("arm")
    drives = {5: np.deg2rad(50.0), 6: np.deg2rad(-20.0)}
    u = closed(rig, drives, homes(rig), np.zeros(3))
    found = loads(rig, u[None], nominal(rig), held(rig, "joint5", "joint6"))
    assert found.moment is not None
    step = 1e-5
    for place, joint in enumerate(rig.mechanism.places):
        for k in range(2):
            raised = []
            for sign in (1, -1):
                tilts = {joint: tuple(sign * step * np.eye(2)[k])}
                raised.append(energy(rig, closed(rig, drives, u, np.zeros(3), tilts), tilts))
            work = (raised[0] - raised[1]) / (2 * step)
            assert found.moment[0, place, k] == pytest.approx(work, abs=1e-5), (joint, k)
    assert np.abs(found.moment).max() > 1.0


def test_under_gravity_compensation_each_joint_raises_what_it_moves_by_itself() -> None:
    rig = compensated(load_rig("arm"))
    u = closed(rig, {}, homes(rig), np.zeros(3))
    found = loads(rig, u[None], nominal(rig), None)
    assert found.torque is not None
    assert found.moment is not None
    step = 1e-5
    for joint in range(len(rig.mechanism.places)):
        each = step * np.eye(len(u))[joint]
        work = (energy(rig, u + each) - energy(rig, u - each)) / (2 * step)
        assert found.torque[0, joint] == pytest.approx(work, abs=1e-6)
        for k in range(2):
            ends = [
                energy(rig, u, {rig.mechanism.places[joint]: tuple(s * step * np.eye(2)[k])})
                for s in (1, -1)
            ]
            lean = (ends[0] - ends[1]) / (2 * step)
            assert found.moment[0, joint, k] == pytest.approx(lean, abs=1e-6)
    assert np.abs(found.torque).max() > 1.0
    np.testing.assert_array_equal(found.force, 0.0)


def test_weight_on_a_joint_that_nobody_senses_cannot_be_compensated() -> None:
    rig = compensated(load_rig("arm"))
    slack = rig.model_copy(update={"channels": tuple(c for c in rig.channels if c.name != "q2")})
    u = closed(rig, {}, homes(rig), np.zeros(3))
    found = loads(slack, u[None], nominal(slack), None)
    assert found.torque is None
    assert "joint2" in found.why


def test_an_upright_joint_carries_nothing_at_all() -> None:
    text = """
schema = 1
name = "upright"
gravity_m_per_s2 = [0, 0, -9.81]
[mechanism]
family = "serial"
standing = "gravity-compensated"
closure = { constraint = "ball" }
[[mechanism.joint]]
name = "waist"
convention = "urdf"
z_m = 0.333
rx_rad = 1e-16  # as a fit leaves what readings do not determine
[[mechanism.joint]]
name = "shoulder"
convention = "urdf"
rx_rad = -1.5707963267948966
mass_kg = 2
com_m = [0.1, 0.02, 0.03]
[[mechanism.joint]]
name = "turn"
convention = "urdf"
y_m = -0.316
rx_rad = 1.5707963267948966
mass_kg = 3
com_m = [0.03, 0.04, -0.07]
[[mechanism.fixture]]
name = "socket"
[[channel]]
name = "q1"
senses = "waist"
gain_deg_per_count = 0.01
[[channel]]
name = "q2"
senses = "shoulder"
gain_deg_per_count = 0.01
[[channel]]
name = "q3"
senses = "turn"
gain_deg_per_count = 0.01
"""
    rig = parse_rig(text)
    u = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 3))
    found = loads(rig, u, nominal(rig), None)
    assert found.torque is not None
    assert not found.torque[:, 0].any()
    assert np.abs(found.torque[:, 1]).min() > 0.0
