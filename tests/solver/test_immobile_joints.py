"""The elbow of an anthropomorphic arm stands still while the hand is held: check, solve and status say so."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import Rig, parameters, parse_rig
from solver.dwells import Window
from solver.mechanism.model import model_of
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.mobility import immobile
from solver.poses.wander import wander
from solver.rig_check import check_rig
from solver.samples import PoseTable
from solver.solve import solve_table

_HOME = (20.0, 40.0, -15.0, 70.0, 25.0, 50.0, -30.0)  # deg
_S = (0.34, 0.0, 0.40, 0.0, 0.39, 0.0, 0.13)  # m
_ALPHA = (-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0)  # deg


def anthropomorphic(constraint: str = "rigid", *, known: bool = False, joints: int = 7) -> Rig:
    """Spherical shoulder, elbow, spherical wrist, the hand in a vice.

    ``known``: the place of the vice and all lengths but one are.
    """
    reached = np.eye(4)
    for angle, s, alpha in list(zip(_HOME, _S, _ALPHA, strict=True))[:joints]:
        reached = reached @ turn(2, angle) @ shift(s) @ turn(0, alpha)
    R = reached[:3, :3]
    rx, ry = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0])
    rz = np.arctan2(R[1, 0], R[0, 0])
    unknown = "" if known else ", uncertainty = 0.005, identify = true"
    angles = [f"{{ nominal = {value}{unknown} }}" for value in (rx, ry, rz)]
    x, y, z = (f"{{ nominal = {value}{unknown} }}" for value in reached[:3, 3])
    text = f"""schema = 1
name = "seven"
[mechanism]
family = "serial"
closure = {{ constraint = "{constraint}" }}
[[mechanism.fixture]]
name = "vice"
x_m = {x}
y_m = {y}
z_m = {z}
rx_rad = {angles[0]}
ry_rad = {angles[1]}
rz_rad = {angles[2]}
"""
    for k, (angle, s, alpha) in enumerate(
        list(zip(_HOME, _S, _ALPHA, strict=True))[:joints], start=1
    ):
        length = f"{{ nominal = {s}, uncertainty = 0.002, identify = true }}"
        text += f"""[[mechanism.joint]]
name = "joint{k}"
home_deg = {angle}
theta_offset_deg = {{ nominal = 0, uncertainty = 1, identify = true }}
s_m = {length if k == 3 or not known else s}
alpha_deg = {alpha}
"""
    for k in range(1, joints + 1):
        text += f"""[[channel]]
name = "q{k}"
senses = "joint{k}"
gain_deg_per_count = 0.001
noise_counts = 1.0
"""
    return parse_rig(text, "seven")


def turn(axis: int, deg: float) -> np.ndarray:
    out, c, s = np.eye(4), np.cos(np.radians(deg)), np.sin(np.radians(deg))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i], out[j, j], out[j, i], out[i, j] = c, c, s, -s
    return out


def shift(along: float) -> np.ndarray:
    out = np.eye(4)
    out[2, 3] = along
    return out


def table(rig: Rig, poses: int = 40) -> PoseTable:
    """Averaged readings while the hand is held."""
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    u = wander(rig, model, space.nominal, poses, seed=1)
    exact = model.linearise(u, space.nominal, space.expansion).readings
    sigma = np.full(exact.shape, 0.16)
    rng = np.random.default_rng(3)
    return PoseTable(
        channels=tuple(channel.name for channel in rig.channels),
        counts=exact + sigma * rng.standard_normal(exact.shape),
        sigma=sigma,
        samples=np.full(exact.shape, 40),
        effective=np.full(exact.shape, 40.0),
        noise=np.ones(exact.shape[1]),
        correlation=np.ones(exact.shape[1]),
        windows=tuple(Window(int(i * 1e9), int(i * 1e9 + 4e8), i, 0) for i in range(poses)),
        rejected=(),
    )


def test_the_elbow_is_the_joint_that_cannot_move() -> None:
    rig = anthropomorphic()
    model, x = model_of(rig), ParameterSpace.of(parameters(rig)).nominal
    assert isinstance(model, SerialModel)
    poses = wander(rig, model, x, 40, seed=0)
    assert model.mobility(poses, x) == 1
    assert immobile(model, x, poses).tolist() == [3]
    ball = anthropomorphic("ball")
    other = model_of(ball)
    assert isinstance(other, SerialModel)
    assert immobile(other, x, wander(ball, other, x, 40, seed=0)).tolist() == []


def test_the_check_names_it_and_what_is_lost() -> None:
    found = check_rig(anthropomorphic())
    (remark,) = [r for r in found.remarks if "cannot move" in r]
    assert remark.startswith("joint4 cannot move while the endpoint is held")
    assert "its offset is not identifiable" in remark
    assert len([r for r in found.remarks if r.startswith("generic poses do not determine")]) > 1
    assert not [r for r in check_rig(anthropomorphic("ball")).remarks if "cannot move" in r]


def test_a_vice_of_known_place_tells_the_offset_all_the_same() -> None:
    found = check_rig(anthropomorphic(known=True))
    (remark,) = [r for r in found.remarks if "cannot move" in r]
    assert "rests on one angle" in remark
    assert "not identifiable" not in remark


def test_a_solve_says_that_the_mechanism_and_not_the_sensor_stands_still() -> None:
    rig = anthropomorphic()
    solved = solve_table(rig, table(rig))
    texts = [f.text for f in solved.findings if f.kind == "no-motion"]
    assert len(texts) == 1
    assert texts[0].startswith("Channel q4 reads the same at every pose: joint4 cannot move")
    assert "stuck" not in texts[0]


def test_an_arm_in_one_line_is_singular_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}._HOME", (0.0,) * 7)
    found = check_rig(anthropomorphic("hinge", known=True))
    (mistake,) = [m for m in found.mistakes if "singular" in m]
    assert "Choose another home or fixture" in mistake


def test_a_six_joint_arm_held_rigidly_cannot_move_at_all() -> None:
    found = check_rig(anthropomorphic(known=True, joints=6))
    assert found.mobility == 0
    assert any("cannot move at all" in mistake for mistake in found.mistakes)
