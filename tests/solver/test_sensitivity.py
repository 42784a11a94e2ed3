"""What an error of each parameter does to the endpoint or plate: against the calibrated pose itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from loopcal.cli import app
from recordings.rig import load_rig, parameters, parse_rig, rig_text
from solver.calibration import Calibration
from solver.estimate.nuisance import Observations
from solver.mechanism.model import model_of
from solver.mechanism.rotation import logarithm
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import wander
from solver.report.pictures.sensitivity import sensitivity_picture
from solver.report.report import render_sensitivity
from solver.sensitivity import Sensitivity, generic_sensitivity, sensitivity


@cache
def generic(name: str) -> Sensitivity:
    return generic_sensitivity(load_rig(name))


def figure(found: Sensitivity, name: str) -> float:
    """Rotation [rad] for one unit of a parameter."""
    i = found.space.names.index(name)
    return float((found.rotation_rms * found.per_unit)[i])


@pytest.mark.parametrize("name", ["arm", "shoulder", "stewart", "hangprinter"])
def test_is_how_far_the_calibrated_pose_moves_when_a_parameter_does(name: str) -> None:
    rig = load_rig(name)
    model, table = model_of(rig), parameters(rig)
    space = ParameterSpace.of(table, [p.name for p in table if p.tie is None][::5])
    x = space.nominal
    coordinates = wander(rig, model, x, 12, seed=3)
    counts = model.linearise(coordinates, x, space.expansion[:, :0]).readings
    observed = Observations(counts, np.ones_like(counts))
    found = sensitivity(model, space, x, observed, coordinates)
    empty = np.zeros((len(space.names), len(space.names)))
    for j, (name_, (_, step)) in enumerate(zip(space.names, found.steps, strict=True)):
        h = 1e-3 * step
        ahead, behind = (
            Calibration(model, space, x + sign * h * space.expansion[:, j], empty).end_poses(
                counts, observed.sigma
            )
            for sign in (1.0, -1.0)
        )
        moved = (ahead.position - behind.position) / (2 * h) * found.errors[j]
        turn = logarithm(np.swapaxes(behind.rotation, 1, 2) @ ahead.rotation)
        turned = np.linalg.norm(turn, axis=1) / (2 * h) * found.errors[j]
        size = np.linalg.norm(moved, axis=1)
        scale = 1e-3 * found.errors[j] + 1e-9
        assert found.displacement_rms[j] == pytest.approx(
            np.sqrt(np.mean(size**2)), rel=1e-3, abs=scale
        ), name_
        assert found.displacement_max[j] == pytest.approx(size.max(), rel=1e-3, abs=scale)
        assert found.rotation_rms[j] == pytest.approx(
            np.sqrt(np.mean(turned**2)), rel=1e-3, abs=scale
        ), name_
        assert found.rotation_max[j] == pytest.approx(turned.max(), rel=1e-3, abs=scale)


def test_the_shoulders_offsets_matter_as_much_as_its_base_points() -> None:
    # Nahvi, Hollerbach & Hayward, 4.1.2 d: "the effects of sensor offsets are as the same order as A1x, A2x, A2y".
    found = generic("shoulder")
    offsets = [figure(found, f"d{k}.offset") for k in range(1, 5)]
    points = [figure(found, name) for name in ("A1.x", "A2.x", "A2.y")]
    assert np.std(offsets) < 0.1 * np.mean(offsets)
    assert 0.3 < np.mean(points) / np.mean(offsets) < 1.0
    assert not found.shifts
    assert np.rad2deg(max(offsets)) == pytest.approx(0.9, abs=0.2)


def test_of_the_arm_the_hinge_moves_nothing_and_lengths_shift_by_themselves() -> None:
    found = generic("arm")
    size = dict(zip(found.space.names, found.displacement_rms, strict=True))
    assert [size[f"hinge.{part}"] for part in ("s", "a", "alpha", "theta_offset")] == [0.0] * 4
    assert size["joint1.s"] == pytest.approx(5e-3)
    assert figure(found, "joint3.theta_offset") == pytest.approx(np.deg2rad(1.0))
    assert figure(found, "q5.offset") == pytest.approx(figure(found, "joint5.theta_offset"))
    known = dict(zip(found.space.names, found.stated, strict=True))
    assert known["joint1.s"]
    assert not known["q1.gain"]


def test_an_unsensed_joint_on_the_way_follows_the_loop() -> None:
    # Without q4 the loop of the arm still says where joint 4 is, and does so through the hinge.
    text = rig_text("arm")[0]
    begin = text.index('name = "q4"')
    begin = text.rindex("[[channel]]", 0, begin)
    end = text.index("[[channel]]", begin + 1)
    found = generic_sensitivity(parse_rig(text[:begin] + text[end:]))
    size = dict(zip(found.space.names, found.displacement_rms, strict=True))
    assert size["hinge.a"] > 1e-4
    assert np.isfinite(list(size.values())).all()


def test_a_tracker_takes_no_part() -> None:
    text = rig_text("arm")[0]
    tracker = """
[[tracker]]
name = "cam"
x_m = { nominal = 1.0, uncertainty = 0.01, identify = true }
[[tracker.marker]]
name = "M"
x_mm = 100
y_mm = 0
z_mm = 0
[[channel]]
name = "mx"
senses = "M.x"
gain_mm_per_count = 0.01
"""
    begin = text.index("[plan]")
    watched = generic_sensitivity(parse_rig(text[:begin] + tracker + text[begin:]))
    assert watched.displacement_rms[watched.space.names.index("cam.x")] == 0.0
    plain = generic("arm")
    shared = [watched.space.names.index(name) for name in plain.space.names]
    np.testing.assert_allclose(watched.displacement_rms[shared], plain.displacement_rms)


def test_the_picture_shows_the_largest_first_and_says_what_has_no_effect() -> None:
    found = generic("arm")
    drawn = sensitivity_picture(found)
    assert drawn.svg.index("joint2.alpha") < drawn.svg.index("q2.gain")
    assert "Without any effect there: hinge.theta_offset, hinge.s, hinge.a, hinge.alpha." in (
        drawn.caption
    )
    assert "smaller ones are not shown" in drawn.caption
    assert "joint1.s 5.0 mm and 0 deg at 5.0 mm" in drawn.svg
    nothing = np.zeros_like(found.errors)
    still = replace(found, displacement_rms=nothing, rotation_rms=nothing)
    assert "hinge.s" in sensitivity_picture(still).caption


def test_the_page_and_the_command(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = CliRunner().invoke(app, ["rig", "sensitivity", "shoulder", "--report", str(page)])
    assert done.exit_code == 0, done.output
    assert "A1.z" in done.output
    html = page.read_text("utf-8")
    assert html == render_sensitivity(load_rig("shoulder"), generic("shoulder"))
    assert html.count('<th scope="row">') == len(generic("shoulder").space.names)
    assert "Displacement" not in html
    again = CliRunner().invoke(app, ["rig", "sensitivity", "shoulder", "--report", str(page)])
    assert again.exit_code == 2
