"""Closed chains against textbook matrices, finite differences and the paper's numbers."""

import numpy as np
import pytest

from recordings.rig import load_rig, parameters, parse_rig
from sim_devices.plant.chain import Chain, chain_geometry

MIXED = """
schema = 1
name = "mixed"
[mechanism]
family = "serial"
closure = {closure}
[[mechanism.joint]]
name = "one"
theta_offset_deg = 20
s_m = 0.1
a_m = 0.3
alpha_deg = 70
[[mechanism.joint]]
name = "two"
type = "prismatic"
theta_offset_deg = -50
s_m = 0.2
a_m = -0.1
alpha_deg = -35
[[mechanism.joint]]
name = "three"
theta_offset_deg = 110
s_m = -0.15
a_m = 0.25
alpha_deg = 15
[[channel]]
name = "c"
senses = "one"
gain_deg_per_count = 0.01
"""
CLOSURES = {
    "rigid": ('{ constraint = "rigid" }', 6),
    "hinge": ('{ constraint = "hinge" }', 5),
    "slider": ('{ constraint = "slider" }', 5),
    "ball": ('{ constraint = "ball" }', 3),
    "plane": ('{ constraint = "plane" }', 3),
    "universal-xy": ('{ constraint = "custom", free = ["rx", "ry"] }', 4),
    "universal-yz": ('{ constraint = "custom", free = ["ry", "rz"] }', 4),
    "mixed": ('{ constraint = "custom", free = ["x", "rz"] }', 4),
    "all": ('{ constraint = "custom", free = ["x", "y", "z", "rx", "ry", "rz"] }', 0),
}


def chain_of(closure="rigid"):
    rig = parse_rig(MIXED.replace("{closure}", CLOSURES[closure][0]))
    values = {parameter.name: parameter.nominal for parameter in parameters(rig)}
    return Chain(rig.mechanism), chain_geometry(rig.mechanism, values)


def textbook(theta, s, a, alpha):
    """The DH matrix as printed in textbooks."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, s],
            [0, 0, 0, 1],
        ]
    )


def test_reaches_where_a_product_of_textbook_matrices_does():
    chain, _ = chain_of()
    rng = np.random.default_rng(5)
    values = rng.uniform(-1, 1, 3)
    T = (
        textbook(np.deg2rad(20) + values[0], 0.1, 0.3, np.deg2rad(70))
        @ textbook(np.deg2rad(-50), 0.2 + values[1], -0.1, np.deg2rad(-35))
        @ textbook(np.deg2rad(110) + values[2], -0.15, 0.25, np.deg2rad(15))
    )
    _, frames, origins = chain.reach(chain_of()[1], values[None])
    np.testing.assert_allclose(frames[0, -1].T, T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(origins[0, -1], T[:3, 3], atol=1e-14)


@pytest.mark.parametrize("closure", CLOSURES)
def test_closure_rate_matches_finite_differences(closure):
    chain, geometry = chain_of(closure)
    here = np.random.default_rng(3).uniform(-1, 1, (1, 3))
    error, rate = chain.closure(geometry, here)
    assert error.shape == (1, CLOSURES[closure][1])
    for joint in range(3):
        step = np.zeros((1, 3))
        step[0, joint] = 1e-6
        ahead, _ = chain.closure(geometry, here + step)
        behind, _ = chain.closure(geometry, here - step)
        np.testing.assert_allclose(rate[:, :, joint], (ahead - behind) / 2e-6, atol=1e-8)


ONE_JOINT = """
schema = 1
name = "one"
[mechanism]
family = "serial"
closure = {closure}
[[mechanism.joint]]
name = "only"
type = "{type}"
[[channel]]
name = "c"
senses = "only"
gain_{unit}_per_count = 0.01
"""


@pytest.mark.parametrize(
    ("type_", "closes"),
    [
        ("revolute", {"hinge", "ball", "plane", "universal-yz", "mixed"}),
        ("prismatic", {"slider"}),
    ],
)
@pytest.mark.parametrize("closure", [name for name in CLOSURES if name not in ("all",)])
def test_a_freedom_about_or_along_the_joint_leaves_it_closed(type_, closes, closure):
    text = ONE_JOINT.replace("{closure}", CLOSURES[closure][0]).replace("{type}", type_)
    rig = parse_rig(text.replace("{unit}", "deg" if type_ == "revolute" else "m"))
    values = {parameter.name: parameter.nominal for parameter in parameters(rig)}
    chain = Chain(rig.mechanism)
    error, _ = chain.closure(chain_geometry(rig.mechanism, values), np.array([[0.7]]))
    assert (np.abs(error).max() < 1e-12) == (closure in closes)


def test_the_papers_arm_closes_with_mobility_two():
    rig = load_rig("arm")
    values = {parameter.name: parameter.nominal for parameter in parameters(rig)}
    chain = Chain(rig.mechanism)
    geometry = chain_geometry(rig.mechanism, values)
    here = np.array([[joint.home.nominal for joint in rig.mechanism.joints]])
    for _ in range(10):
        error, rate = chain.closure(geometry, here)
        here = here - np.linalg.pinv(rate[0]) @ error[0]
    error, rate = chain.closure(geometry, here)
    assert np.abs(error).max() < 1e-12
    sizes = np.linalg.svd(rate[0], compute_uv=False)
    assert sizes[5] > 1e-3
    assert rate.shape[2] - 6 == 2


def test_geometry_may_vary_by_sample():
    chain, geometry = chain_of()
    here = np.random.default_rng(1).uniform(-1, 1, (4, 3))
    shifted = geometry.s + np.arange(4)[:, None] * np.array([[0.01, 0.0, 0.0]])
    varying = type(geometry)(
        geometry.theta_offset,
        shifted,
        geometry.a,
        geometry.alpha,
        geometry.fixture_turn,
        np.zeros((4, 3)),
    )
    together, _ = chain.closure(varying, here)
    for k in range(4):
        alone = type(geometry)(
            geometry.theta_offset,
            shifted[k],
            geometry.a,
            geometry.alpha,
            geometry.fixture_turn,
            geometry.fixture_shift,
        )
        np.testing.assert_allclose(
            together[k], chain.closure(alone, here[k : k + 1])[0][0], atol=1e-14
        )
