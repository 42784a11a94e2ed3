"""Rigs from URDF, and back into the same document with other origins."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import recordings
from recordings.errors import RigError
from recordings.rig import parameters, parse_rig
from recordings.urdf import Doubts, calibrated_urdf, rig_from_urdf
from solver.mechanism.model import model_of

PANDA = (
    Path(recordings.__file__).parent.parent / "benchmarks/data/panda_ball_joint/panda.urdf"
).read_text("utf-8")
ARM = """<?xml version="1.0"?>
<!-- an arm -->
<robot name="bent">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
  <joint name="fixed1" type="fixed"><parent link="base"/><child link="a"/><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="turn" type="continuous"><parent link="a"/><child link="b"/><origin xyz="1 0 0" rpy="0.1 0.2 0.3"/><axis xyz="0 3 4"/></joint>
  <joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/><limit lower="0" upper="0.2" effort="1" velocity="1"/></joint>
  <joint name="held" type="fixed"><parent link="c"/><child link="tool"/><origin xyz="0 0.5 0"/></joint>
</robot>
"""


def values(rig: str) -> dict[str, float]:
    return {p.name: p.nominal for p in parameters(parse_rig(rig))}


def test_fixed_joints_are_folded_into_the_next_origin() -> None:
    rig = parse_rig(rig_from_urdf(ARM, "tool", "hinge", doubts=Doubts(length_m=1e-3, angle_rad=0)))
    found = {p.name: p for p in parameters(rig)}
    np.testing.assert_allclose([found[f"turn.{k}"].nominal for k in "xyz"], [0, 1, 1], atol=1e-12)
    assert found["turn.rz"].nominal == pytest.approx(0.3 + np.pi / 2)
    assert found["turn.x"].uncertainty == 1e-3
    assert not found["turn.rx"].identify
    assert found["tip.y"].nominal == 0.5
    # A hinge's own angle is free, so that the fixture's turn about it is not sought.
    assert found["fixture.ry"].identify
    assert not found["fixture.rz"].identify
    assert [c.gain.dimension for c in rig.channels] == ["angle/count", "length/count"]


@pytest.mark.parametrize(("text", "tip"), [(ARM, "tool"), (PANDA, "ball_link")])
def test_calibrated_origins_come_back(text: str, tip: str) -> None:
    rig = rig_from_urdf(text, tip, "ball")
    rng = np.random.default_rng(0)
    truth = {
        name: value + 0.01 * rng.standard_normal() if name[0] != "q" else value
        for name, value in values(rig).items()
    }
    written = calibrated_urdf(text, tip, truth)
    again = values(rig_from_urdf(written, tip, "ball"))
    for name, value in truth.items():
        if not name.startswith("fixture"):
            assert again[name] == pytest.approx(value, abs=1e-9), name
    assert written.split("<robot")[0] == text.split("<robot")[0]
    kept = [line for line in text.splitlines() if "<origin" not in line and "<joint" not in line]
    assert {line.replace(" />", "/>") for line in kept} <= set(written.splitlines())


def test_encoder_offsets_become_part_of_the_origin() -> None:
    found = values(rig_from_urdf(PANDA, "ball_link", "ball", doubts=Doubts(encoder_rad=0.01)))
    moved = values(
        rig_from_urdf(
            calibrated_urdf(PANDA, "ball_link", found | {"q1.offset": 0.02}), "ball_link", "ball"
        )
    )
    assert moved["panda_joint1.rz"] == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("text", "tip", "constraint", "message"),
    [
        ("<robot", "tool", "ball", "not a URDF"),
        (ARM, "hand", "ball", "no link 'hand'; it has: a, b, base"),
        (ARM, "tool", "glue", "the constraint is 'glue'"),
        (ARM, "a", "ball", "no joint moves"),
        (ARM.replace("continuous", "floating"), "tool", "ball", "of type floating"),
        (ARM.replace("0 3 4", "0 0 0"), "tool", "ball", "axis of length 0"),
        (PANDA, "panda_rightfinger", "ball", "mimics 'panda_finger_joint1'"),
    ],
)
def test_what_cannot_be_a_rig_is_told(text: str, tip: str, constraint: str, message: str) -> None:
    with pytest.raises(RigError, match=message):
        rig_from_urdf(text, tip, constraint)


RIGHT = np.pi / 2


def upright(pitches: tuple[float, ...], tip: float | None) -> str:
    """An arm of four joints whose origins have these pitches, and a tool at ``tip`` or none."""
    parts = ['<robot name="steep"><link name="l0"/>']
    for k, pitch in enumerate(pitches, 1):
        axis = ("0 0 1", "1 0 0", "0 0.6 0.8", "0 1 0")[k % 4]
        parts.append(
            f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="l{k - 1}"/>'
            f'<child link="l{k}"/><origin xyz="0.1 {0.05 * k} 0.3" rpy="{0.3 * k} {pitch} {-0.2 * k}"/>'
            f'<axis xyz="{axis}"/><limit lower="-0.4" upper="0.8" effort="1" velocity="1"/></joint>'
        )
    last = f"l{len(pitches)}"
    if tip is not None:
        parts.append(
            f'<link name="tool"/><joint name="held" type="fixed"><parent link="{last}"/>'
            f'<child link="tool"/><origin xyz="0.02 0.03 0.1" rpy="0.1 {tip} 0.4"/></joint>'
        )
    return "".join(parts) + "</robot>"


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    hat = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * hat + (1 - np.cos(angle)) * hat @ hat


def reached(text: str, angles: np.ndarray) -> np.ndarray:
    """(4, 4), where a URDF of one branch ends, read and multiplied out by itself."""
    out = np.eye(4)
    moving = iter(angles)
    for joint in ElementTree.fromstring(text.encode("utf-8")).findall("joint"):
        origin = joint.find("origin")
        assert origin is not None
        rx, ry, rz = (float(v) for v in origin.attrib["rpy"].split())
        x, y, z = np.eye(3)
        step = np.eye(4)
        step[:3, :3] = turn(z, rz) @ turn(y, ry) @ turn(x, rx)
        step[:3, 3] = [float(v) for v in origin.attrib["xyz"].split()]
        out = out @ step
        axis = joint.find("axis")
        if axis is not None:
            step = np.eye(4)
            step[:3, :3] = turn(
                np.array([float(v) for v in axis.attrib["xyz"].split()]), next(moving)
            )
            out = out @ step
    return out


@pytest.mark.parametrize("tip", [None, RIGHT, -RIGHT, 0.2])
@pytest.mark.parametrize(
    "pitches", [(RIGHT, -RIGHT, RIGHT, -RIGHT), (0.1, 0.2, RIGHT, 0.3), (0.2, 0.1, 0.1, -RIGHT)]
)
def test_origins_at_right_angles_lose_no_turn(
    pitches: tuple[float, ...], tip: float | None
) -> None:
    text, end = upright(pitches, tip), "l4" if tip is None else "tool"
    toml = rig_from_urdf(text, end, "rigid", doubts=Doubts(encoder_rad=0.01))
    rig = parse_rig(toml)
    model, table = model_of(rig), parameters(rig)
    index = {p.name: k for k, p in enumerate(table)}
    for owner in ("j1", "j2", "j3", "j4", "fixture", *(["tip"] if tip is not None else [])):
        assert abs(np.cos(table[index[f"{owner}.ry"]].nominal)) > 0.09, owner
        assert all(table[index[f"{owner}.{part}"]].identify for part in ("rx", "ry", "rz")), owner
    # With errors of every origin and sensor, what is exported moves as the calibrated rig does.
    rng = np.random.default_rng(1)
    moved = np.array([0.02 * rng.standard_normal() if p.identify else 0.0 for p in table])
    x = np.array([p.nominal for p in table]) + moved
    angles = rng.uniform(-0.4, 0.8, (6, 4))
    offsets = x[[index[f"q{k}.offset"] for k in range(1, 5)]]
    written = calibrated_urdf(text, end, dict(zip(index, x.tolist(), strict=True)))
    ends = model.end_pose(angles + offsets, x, np.eye(len(x)))
    nominal = model.end_pose(angles, x - moved, np.eye(len(x))[:, :0])
    aside = np.linalg.inv(reached(text, angles[0])[:3, :3]) @ nominal.rotation[0]
    assert abs(aside[2, 2]) == pytest.approx(1.0)  # at most turned about the tip's own z
    for k, row in enumerate(angles):
        expected = reached(text, row)
        np.testing.assert_allclose(nominal.position[k], expected[:3, 3], atol=1e-12)
        np.testing.assert_allclose(nominal.rotation[k], expected[:3, :3] @ aside, atol=1e-12)
        expected = reached(written, row)
        np.testing.assert_allclose(ends.position[k], expected[:3, 3], atol=1e-12)
        np.testing.assert_allclose(ends.rotation[k], expected[:3, :3] @ aside, atol=1e-12)
    # Small errors of the three angles are every small rotation.
    for joint in ("j1", "j2", "j3", "j4"):
        columns = [index[f"{joint}.{part}"] for part in ("rx", "ry", "rz")]
        rates = ends.by_parameters[0, 3:, columns]
        assert np.linalg.svd(rates, compute_uv=False)[-1] > 0.05, joint


@pytest.mark.parametrize("constraint", ["rigid", "hinge", "slider", "ball", "plane"])
def test_without_right_angles_frames_are_those_of_the_urdf(constraint: str) -> None:
    toml = rig_from_urdf(upright((0.1, 0.2, 0.3, 0.4), 0.2), "tool", constraint)
    assert "permuted" not in toml
    found = values(toml)
    assert (found["j2.rx"], found["j2.ry"]) == pytest.approx((0.6, 0.2))


HEAVY = """<robot name="heavy">
  <link name="base"><inertial><mass value="9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 0.1"/><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="tool"><inertial><mass value="3"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="finger"><inertial><mass value="4"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="first" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="second" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0 0.4 0"/></joint>
  <joint name="grip" type="prismatic"><parent link="tool"/><child link="finger"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/><limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>
</robot>
"""


def test_weights_of_links_and_of_what_hangs_on_them_become_those_of_joints() -> None:
    rig = parse_rig(rig_from_urdf(HEAVY, "tool", "ball", gravity_compensated=True))
    first, second = rig.mechanism.joints
    assert (first.mass, second.mass) == (2.0, 8.0)  # lower, tool, and finger on the tool
    np.testing.assert_allclose(first.com, (0.0, 0.0, 0.1), atol=1e-12)
    np.testing.assert_allclose(second.com, (0.2 / 8, 7 * 0.4 / 8, 4 * 0.1 / 8), atol=1e-12)
    assert rig.gravity == pytest.approx((0.0, 0.0, -9.80665))
    assert rig.mechanism.standing == "gravity-compensated"


def test_centres_of_mass_follow_a_frame_whose_axes_are_permuted() -> None:
    upright = HEAVY.replace('rpy="1.5707963267948966 0 0"', 'rpy="0 1.5707963267948966 0"')
    text = rig_from_urdf(upright, "tool", "ball")
    assert "axes permuted" in text
    rig = parse_rig(text)
    tip = np.array([values(text)[f"tip.{axis}"] for axis in "xyz"])
    centre = np.array(rig.mechanism.joints[1].com)
    # In the URDF's frame the tool is at (0, 0.4, 0) and the centre at (0.025, 0.35, 0.05).
    assert np.linalg.norm(tip) == pytest.approx(0.4)
    assert centre @ tip == pytest.approx(0.35 * 0.4)
    assert np.linalg.norm(centre) == pytest.approx(np.linalg.norm([0.025, 0.35, 0.05]))


def test_without_masses_a_rig_says_nothing_of_gravity() -> None:
    rig = parse_rig(rig_from_urdf(PANDA, "ball_link", "ball"))
    assert rig.gravity is None
    assert all(joint.mass is None for joint in rig.mechanism.joints)
    assert rig.mechanism.standing == "on-drives"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<mass value="2"/>', '<mass value="-2"/>', "'upper' has the mass -2 kg"),
        ('<mass value="2"/>', '<mass value="inf"/>', "weigh inf kg"),
        ('<origin xyz="0.2 0 0"/>', '<origin xyz="nan 0 0"/>', "'lower' and what hangs on it"),
    ],
)
def test_weights_that_cannot_be(old: str, new: str, message: str) -> None:
    with pytest.raises(RigError, match=message):
        rig_from_urdf(HEAVY.replace(old, new), "tool", "ball")
