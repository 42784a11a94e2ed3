"""Joints beside the hinge that no channel senses: the arm still finds the truth, and says what it cannot."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import Rig, load_rig, parameters, parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.estimate.branches import assemblies, closure_error
from solver.estimate.nuisance import Observations
from solver.estimate.trust_region import Status
from solver.mechanism.model import model_of
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import wander
from solver.solve import solve

# Where joint 6 has no sensor nothing can drive it: joints 2 and 5 lead instead.
_PLAN = """[plan]
mode = "driven"
sample_hz = 100
drives = ["joint2", "joint5"]
corners_deg = [[-26, 33], [-23, 60], [-11, 72], [-3, 80], [3, 80], [3, 42], [-7, 24], [-19, 16], [-23, 14]]
move_deg_per_s = 90
poses = 60
seed = 21
dwell_s = 0.3
settle_s = 0.15
"""


def without(*unsensed: int) -> tuple[Rig, str]:
    """The arm without the channels of these joints, and its text."""
    text = rig_text("arm")[0]
    for joint in unsensed:
        text = re.sub(rf'\[\[channel\]\]\nname = "q{joint}"\n(?:.+\n)+\n', "", text)
    if 6 in unsensed:
        text = text[: text.index("# Joints 5 and 6 move")] + _PLAN
    return parse_rig(text, "arm"), text


@pytest.mark.parametrize(("unsensed", "seed"), [((7,), 1), ((7,), 2), ((6, 7), 1), ((6, 7), 5)])
def test_the_arm_finds_the_truth(tmp_path: Path, unsensed: tuple[int, ...], seed: int) -> None:
    rig, text = without(*unsensed)
    truth = simulate(rig, text, tmp_path / "arm.mcap", seed=seed)
    solved = solve(read_recording(tmp_path / "arm.mcap"))
    estimate, space = solved.estimate, solved.estimate.space
    assert estimate.status is Status.CONVERGED
    assert estimate.misfit < 1.4
    true = np.array([truth.parameters[p.name] for p in parameters(rig)])
    errors = np.abs(estimate.values - space.reduce(true)) / estimate.standard_errors
    assert errors.max() < 4.5
    offsets = {f"joint{joint}.theta_offset, which no pose shows" for joint in unsensed}
    assert set(solved.identifiability.combinations) == offsets
    determined = [
        not name.endswith(tuple(f"{j}.theta_offset" for j in unsensed)) for name in space.names
    ]
    small = estimate.standard_errors / space.uncertainty
    assert small[determined].max() < 0.05


def test_an_assembly_is_kept_from_pose_to_pose() -> None:
    rig, _ = without(6, 7)
    model = model_of(rig)
    assert isinstance(model, SerialModel)
    x = ParameterSpace.of(parameters(rig)).nominal
    u = wander(load_rig("arm"), model, x, 60, seed=3)
    counts = model.linearise(u, x, np.zeros((len(x), 0))).readings
    observed = Observations(counts, np.ones_like(counts))
    found = assemblies(model, observed, x)
    assert len(found) > 1
    left = [closure_error(model, observed, x, one).sum() for one in found]
    assert left[0] < 1e-12
    assert left == sorted(left)
    apart = found[0] - u
    assert np.abs(apart - 2 * np.pi * np.round(apart / (2 * np.pi))).max() < 1e-6
