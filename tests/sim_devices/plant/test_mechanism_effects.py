"""Effects that act on the mechanism: the loop closes where the independent calculation says."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parameters, parse_rig, rig_text
from sim_devices.plant.chain import Chain, chain_geometry
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.effects.loads import loads_of
from sim_devices.plant.effects.mount import Mount
from sim_devices.plant.effects.registry import EFFECT_KINDS
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.loop import Loop
from sim_devices.plant.nature import nature_of
from sim_devices.plant.plate import plate_geometry
from sim_devices.plant.quaternion import turn
from sim_devices.plant.session import play, rests, scripted_hand
from sim_devices.plant.stop import LEAD_S

POSES = 5


def stands(nature):
    """Closed configurations (n, J) at the stops, and when."""
    found = rests(nature, POSES)
    return found.coordinates, found.time_s


def closing(rig, values, variables):
    """(n, m) closure error of the chain without effects."""
    geometry = chain_geometry(rig.mechanism, values)
    return Loop(rig.mechanism, geometry).closure(variables, np.zeros(len(variables)))[0]


def end(rig, values, variables):
    """(n, 3) where the chain without effects ends, seen from where it should."""
    geometry = chain_geometry(rig.mechanism, values)
    _, frames, origins = Chain(rig.mechanism).reach(geometry, variables)
    return origins[:, -1], frames[:, -1]


def test_a_yielding_joint_is_behind_its_sensor_by_torque_and_compliance(describing):
    rig = describing("arm", "joint-compliance", "joint6", compliance_deg_per_Nm=0.05)
    nature = nature_of(rig, make_nature(rig, 2).truth)
    motor, _ = stands(nature)
    assert np.abs(closing(rig, nature.truth.parameters, motor)).max() > 1e-5
    link = motor.copy()
    values = nature.truth.parameters
    for _ in range(9):
        load = loads_of(rig, values).of_chain(chain_geometry(rig.mechanism, values), link)
        link[:, 6] = motor[:, 6] - np.deg2rad(0.05) * load.torque[:, 6]
    np.testing.assert_allclose(closing(rig, values, link), 0.0, atol=1e-8)
    assert np.abs(load.torque[:, 6]).max() > 0.2


def test_a_hidden_spring_hardens_and_has_the_slope_asked_for(arm):
    nature = make_nature(arm, 2, ["joint-compliance@joint6=0.05"], poses=POSES)
    (effect,) = nature.sensors["q6"]._effects
    values = nature.truth.parameters
    at = stands(make_nature(arm, 2))[0]
    load = loads_of(arm, values).of_chain(chain_geometry(arm.mechanism, values), at).torque[:, 6]
    given = np.rad2deg(effect._spring(load))
    assert np.polyfit(load, given, 1)[0] == pytest.approx(0.05, rel=1e-6)
    loads = np.linspace(0, np.abs(load).max(), 50)
    slope = np.diff(effect._spring(loads))
    assert np.all(np.diff(slope) < 0)
    assert 0.8 < slope[-1] / slope[0] < 0.95


def test_a_yielding_fixture_lets_the_chain_end_where_it_pushes_it(describing):
    rig = describing("arm", "fixture-compliance", "fixture", compliance_m_per_N=2e-5)
    nature = nature_of(rig, make_nature(rig, 2).truth)
    at, _ = stands(nature)
    values = nature.truth.parameters
    geometry = nature.mechanism.geometry(at, np.zeros(len(at)))
    force = loads_of(rig, values).of_chain(geometry, at).force
    where, axes = end(rig, values, at)
    np.testing.assert_allclose(where, 2e-5 * force, atol=1e-8)
    np.testing.assert_allclose(axes, np.broadcast_to(np.eye(3), axes.shape), atol=1e-9)
    assert np.linalg.norm(where, axis=1).min() > 1e-4


def test_a_hidden_fixture_is_nearly_equally_stiff_and_tilts_little(arm):
    nature = make_nature(arm, 2, ["fixture-compliance@fixture=2e-5"])
    at, _ = stands(nature)
    values = nature.truth.parameters
    where, axes = end(arm, values, at)
    geometry = nature.mechanism.geometry(at, np.zeros(len(at)))
    hinge = Mount(arm.mechanism, values).frame(chain_geometry(arm.mechanism, values), at)
    force, _ = loads_of(arm, values).of_chain(geometry, at).seen_from(hinge)
    ratio = turn(hinge.back.turn, where) / (2e-5 * force)
    assert np.all(np.abs(ratio[np.abs(force) > 3.0] - 1) < 0.3)
    assert np.ptp(np.median(ratio, axis=0)) > 0.01
    tilt = np.arccos(np.clip((np.trace(axes, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert 0 < tilt.max() < 1e-3


def test_a_slip_displaces_the_hinge_on_its_stand_from_its_moment_on(describing):
    rig = describing("arm", "fixture-slip", "fixture", at_s=6.0, x_mm=1.0, z_mm=-0.5, ry_deg=0.1)
    nature = nature_of(rig, make_nature(rig, 2).truth)
    played = play(nature, POSES)
    bare = play(make_nature(rig.model_copy(update={"effects": ()}), 2), POSES)
    early = played.course.time_s < 6.0
    for name, value in played.course.value.items():
        np.testing.assert_allclose(value[early], bare.course.value[name][early], atol=1e-10)
    # The loop with the slip, closed anew at one late pose: the hinge stands displaced on the base.
    loop = nature.mechanism
    start = loop.assemble(np.random.default_rng(0))[None]
    held = np.isin(rig.mechanism.places, rig.plan.drives)
    for time_s, share in ((5.9, 0.0), (6.0, 1.0)):
        closed, left = loop.polish(start, held, np.array([time_s]))
        assert left.max() < 1e-11
        values = nature.truth.parameters
        hinge, rest = np.eye(4), np.eye(4)
        for k, joint in enumerate(rig.mechanism.joints):
            moved = denavit_hartenberg(values, joint.name, closed[0, k])
            hinge, rest = (moved, rest) if k == 0 else (hinge, rest @ moved)
        # Base from stand, as the arm's end finds it behind the hinge.
        slip = rest @ hinge
        np.testing.assert_allclose(slip[:3, 3], share * np.array([1e-3, 0, -0.5e-3]), atol=1e-9)
        turned = share * np.deg2rad(0.1)
        np.testing.assert_allclose(slip[:3, 2], [np.sin(turned), 0, np.cos(turned)], atol=1e-9)


def denavit_hartenberg(values, joint, variable):
    """4 x 4 transform of a joint."""
    theta, s, a, alpha = (values[f"{joint}.{p}"] for p in ("theta_offset", "s", "a", "alpha"))
    ct, st = np.cos(theta + variable), np.sin(theta + variable)
    ca, sa = np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, s],
            [0, 0, 0, 1],
        ]
    )


def test_growing_links_close_as_a_chain_of_longer_links(describing):
    rig = describing("arm", "thermal-growth", "links", rate_ppm_per_s=20)
    nature = nature_of(rig, make_nature(rig, 2).truth)
    loop = nature.mechanism
    start = loop.assemble(np.random.default_rng(0))[None]
    held = np.isin(rig.mechanism.places, rig.plan.drives)
    closed, _ = loop.polish(start, held, np.array([50.0]))
    longer = {
        name: value * 1.001 if name.endswith((".a", ".s")) and "hinge" not in name else value
        for name, value in nature.truth.parameters.items()
    }
    np.testing.assert_allclose(closing(rig, longer, closed), 0.0, atol=1e-10)
    assert np.abs(closing(rig, nature.truth.parameters, closed)).max() > 1e-5


URDF = """
schema = 1
name = "cart"
[mechanism]
family = "serial"
closure = { constraint = "ball" }
tip = { x_m = 0.2 }
[[mechanism.joint]]
name = "j1"
convention = "urdf"
z_m = 0.3
home_deg = 10
[[mechanism.joint]]
name = "j2"
convention = "urdf"
axis = "y"
x_m = 0.1
home_deg = 20
[[mechanism.joint]]
name = "j3"
convention = "urdf"
axis = "y"
z_m = 0.4
home_deg = 30
[[mechanism.joint]]
name = "j4"
convention = "urdf"
axis = "y"
x_m = 0.3
home_deg = 40
[[mechanism.fixture]]
name = "socket"
x_m = 0.6
y_m = 0.1
z_m = 0.2
"""


def test_growth_of_described_origins_and_tips_leaves_the_fixture_where_it_is(describing):
    channels = "".join(
        f'[[channel]]\nname = "c{k}"\nsenses = "j{k}"\ngain_deg_per_count = 0.01\n'
        for k in (1, 2, 3, 4)
    )
    effect = '[[effect]]\nname = "thermal-growth"\nwhere = "links"\nrate_per_s = 1e-4\n'
    rig = parse_rig(URDF + channels + effect)
    nature = nature_of(rig, make_nature(rig, 0).truth)
    rng = np.random.default_rng(1)
    variables = rng.uniform(-1, 1, (6, 4))
    longer = {
        name: value * 1.01 if name.endswith((".x", ".y", ".z")) and "socket" not in name else value
        for name, value in nature.truth.parameters.items()
    }
    grown, _ = nature.mechanism.closure(variables, np.full(6, 100.0))
    geometry = chain_geometry(rig.mechanism, longer, "socket")
    expected, _ = Loop(rig.mechanism, geometry).closure(variables, np.zeros(6))
    np.testing.assert_allclose(grown, expected, atol=1e-12)


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_a_wrong_parameter_is_the_true_one_and_its_followers_follow(name):
    text, source = rig_text(name)
    text = text.replace("{ nominal = -28.8, uncertainty = 0.5, identify = true }", "-28.8")
    rig = parse_rig(text, source)
    where, size = ("joint3.s", 0.002) if name == "arm" else ("A2.x", -0.001)
    plain = make_nature(rig, 1).truth.parameters
    wrong = make_nature(rig, 1, [f"link-geometry@{where}={size}"]).truth.parameters
    moved = {n: wrong[n] - plain[n] for n in plain if wrong[n] != plain[n]}
    expected = {where: size} if name == "arm" else {where: size, "A3.x": -size}
    assert moved == pytest.approx(expected)


def test_places_of_wrong_parameters_are_fixed_ones_of_the_mechanism(arm, shoulder):
    for rig in (arm, shoulder):
        known = {p.name: p for p in parameters(rig)}
        places = EFFECT_KINDS["link-geometry"].places(rig)
        assert places
        for place in places:
            assert not known[place].identify
            assert known[place].tie is None
            assert not place.endswith((".gain", ".offset"))
    places = EFFECT_KINDS["link-geometry"].places(arm)
    assert "joint3.s" in places
    assert "joint2.alpha" in places
    assert "joint2.a" not in places  # axes that meet: axis-offset
    assert "hinge.theta_offset" not in places  # turns with the hinge, which nothing senses


def test_axes_that_should_meet_pass_at_the_distance(arm):
    assert EFFECT_KINDS["axis-offset"].places(arm) == tuple(f"joint{k}" for k in range(1, 7))
    nature = make_nature(arm, 1, ["axis-offset@joint2=0.002"], poses=POSES)
    assert nature.truth.parameters["joint2.a"] == 0.002
    at, _ = stands(nature)
    _, frames, origins = Chain(arm.mechanism).reach(
        chain_geometry(arm.mechanism, nature.truth.parameters), at
    )
    across = np.cross(frames[:, 2, 2], frames[:, 3, 2])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    apart = np.abs(((origins[:, 3] - origins[:, 2]) * across).sum(axis=1))
    np.testing.assert_allclose(apart, 0.002, rtol=1e-6)


def shoulder_poses(nature):
    hand = scripted_hand(nature, nature.mechanism, POSES)
    times = np.array([stop.arrive_s for stop in hand.round(0, LEAD_S)])
    return *hand.plate_at(times), times


def legs_by_hand(nature, turned, base, plate):
    return np.linalg.norm(base - turn(turned[:, None], plate), axis=-1)


@pytest.fixture
def shoulder_bare(shoulder):
    """Nature of the shoulder, its plate turns and times at stops, and the ends of its legs."""
    nature = make_nature(shoulder, 4)
    turned, shifted, times = shoulder_poses(nature)
    ends = plate_geometry(shoulder.mechanism, nature.truth.parameters)
    return nature, turned, shifted, times, ends


def test_a_leg_is_stretched_beyond_what_its_sensor_shows(describing, shoulder_bare):
    bare, turned, shifted, times, ends = shoulder_bare
    rig = describing("shoulder", "joint-compliance", "leg3", compliance_m_per_N=1e-5)
    nature = nature_of(rig, make_nature(rig, 4).truth)
    tension = loads_of(rig, {}).of_plate(ends, np.hstack([turned, shifted])).tension
    shown = nature.mechanism.lengths(turned, shifted, times)
    plain = bare.mechanism.lengths(turned, shifted, times)
    np.testing.assert_allclose(shown[:, 2], plain[:, 2] - 1e-5 * tension[:, 2], atol=1e-12)
    np.testing.assert_array_equal(shown[:, [0, 1, 3]], plain[:, [0, 1, 3]])


def test_a_yielding_pivot_moves_with_the_force_on_it(describing, shoulder_bare):
    _, turned, shifted, times, ends = shoulder_bare
    rig = describing("shoulder", "fixture-compliance", "fixture", compliance_m_per_N=1e-5)
    nature = nature_of(rig, make_nature(rig, 4).truth)
    given = np.zeros((len(turned), 1, 3))
    for _ in range(4):
        there = type(ends)(ends.base - given, ends.plate)
        force = loads_of(rig, {}).of_plate(there, np.hstack([turned, shifted])).force
        given = 1e-5 * force[:, None]
    shown = nature.mechanism.lengths(turned, shifted, times)
    expected = np.linalg.norm(ends.base - turn(turned[:, None], ends.plate) - given, axis=-1)
    np.testing.assert_allclose(shown, expected, atol=1e-8)
    assert np.abs(given).max() > 1e-5


def test_a_pivot_slips_and_legs_end_beside_their_point(describing, shoulder_bare):
    _, turned, shifted, times, ends = shoulder_bare
    at_s = float(times[2])
    rig = describing("shoulder", "fixture-slip", "fixture", at_s=at_s, x_mm=1.0, y_mm=-2.0)
    nature = nature_of(rig, make_nature(rig, 4).truth)
    slip = np.where((times >= at_s)[:, None], [[1e-3, -2e-3, 0.0]], 0.0)[:, None]
    np.testing.assert_allclose(
        nature.mechanism.lengths(turned, shifted, times),
        np.linalg.norm(turn(turned[:, None], ends.plate) + slip - ends.base, axis=-1),
        atol=1e-14,
    )
    assert EFFECT_KINDS["axis-offset"].places(rig) == ("B1", "B2")
    rig = describing("shoulder", "axis-offset", "B2", x_mm=1.0, z_mm=-3.0)
    nature = nature_of(rig, make_nature(rig, 4).truth)
    plate = ends.plate.copy()
    plate[3] += [1e-3, 0.0, -3e-3]
    np.testing.assert_allclose(
        nature.mechanism.lengths(turned, shifted, times),
        legs_by_hand(nature, turned, ends.base, plate),
        atol=1e-14,
    )


def test_a_growing_platform_keeps_its_shape(describing, shoulder_bare):
    bare, turned, shifted, times, _ = shoulder_bare
    rig = describing("shoulder", "thermal-growth", "links", rate_ppm_per_s=10)
    nature = nature_of(rig, make_nature(rig, 4).truth)
    plain = bare.mechanism.lengths(turned, shifted, times)
    grown = nature.mechanism.lengths(turned, shifted, times)
    np.testing.assert_allclose(grown, plain * (1 + 1e-5 * times[:, None]), rtol=1e-12)
    rig = describing("shoulder", "thermal-growth", "links", rate_ppm_per_s=10, decay_per_s=0.02)
    nature = nature_of(rig, make_nature(rig, 4).truth)
    warmer = 5e-4 * (1 - np.exp(-times[:, None] / 50.0))
    grown = nature.mechanism.lengths(turned, shifted, times)
    np.testing.assert_allclose(grown, plain * (1 + warmer), rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "case", "size"),
    [
        ("arm", "joint-compliance@joint5", 0.02),
        ("arm", "fixture-compliance@fixture", 1e-5),
        ("arm", "fixture-slip@fixture", 1e-3),
        ("arm", "axis-offset@joint4", 1e-3),
        ("arm", "thermal-growth@links", 1e-5),
        ("shoulder", "joint-compliance@leg2", 1e-5),
        ("shoulder", "fixture-compliance@fixture", 1e-5),
        ("shoulder", "fixture-slip@fixture", 1e-3),
        ("shoulder", "axis-offset@B1", 1e-3),
        ("shoulder", "thermal-growth@links", 1e-5),
    ],
)
def test_it_moves_the_mechanism_in_proportion_and_leaves_the_sensors_alone(name, case, size):
    text, source = rig_text(name)
    rig = parse_rig(text, source)
    plain = rests(make_nature(rig, 3), POSES)

    def moved(share):
        nature = make_nature(rig, 3, [f"{case}={share * size}"])
        for effect in (e for s in nature.sensors.values() for e in s._effects):
            assert type(effect).seen is Effect.seen
            assert type(effect).at_rest is Effect.at_rest
            assert type(effect).counts is Effect.counts
        assert nature.truth.effects[0].size == pytest.approx(share * size)
        if name == "arm":
            closed, _ = nature.mechanism.polish(
                plain.coordinates, np.isin(rig.mechanism.places, rig.plan.drives),
                np.full(len(plain.coordinates), 1e3),
            )  # fmt: skip
            return closed - plain.coordinates
        turned, shifted = plain.coordinates[:, :4], plain.coordinates[:, 4:]
        late = np.full(len(turned), 1e3)
        bare = make_nature(rig, 3).mechanism.lengths(turned, shifted, late)
        return nature.mechanism.lengths(turned, shifted, late) - bare

    half, whole = moved(0.5), moved(1.0)
    assert np.abs(whole).max() > 1e-6
    np.testing.assert_allclose(2 * half, whole, atol=0.05 * np.abs(whole).max())


def test_loads_need_masses_gravity_and_something_that_holds(arm, shoulder):
    compliant = [EFFECT_KINDS[name] for name in ("joint-compliance", "fixture-compliance")]
    assert [kind.places(arm) for kind in compliant] == [("joint5", "joint6"), ("fixture",)]
    assert compliant[0].places(shoulder) == ("leg1", "leg2", "leg3", "leg4")
    for rig in (arm, shoulder):
        weightless = rig.model_copy(update={"gravity": None})
        assert [kind.places(weightless) for kind in compliant] == [(), ()]
    by_hand = shoulder.mechanism.model_copy(update={"standing": "held-by-hand"})
    held = shoulder.model_copy(update={"mechanism": by_hand})
    assert [kind.places(held) for kind in compliant] == [(), ()]
    with pytest.raises(BadEffect, match="no such place"):
        make_nature(held, 0, ["joint-compliance@leg1=1e-5"])
