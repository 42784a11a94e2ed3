"""Rigs from URDF, and back into the same document with other origins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import recordings
from recordings.errors import RigError
from recordings.rig import parameters, parse_rig
from recordings.urdf import Doubts, calibrated_urdf, rig_from_urdf

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
