"""A result put to use: poses with honest uncertainty, the calibrated rig, channel corrections."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from recordings.reader import read_recording
from recordings.rig import load_rig, parameters, rig_text
from sim_devices.simulate import simulate
from solver.calibration import Calibration
from solver.estimate.nuisance import Observations, assemble, settle
from solver.mechanism.rotation import logarithm
from solver.result import result
from solver.samples import average
from solver.solve import solve

Run = Callable[..., Result]


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_poses_are_as_wrong_as_they_say(name: str, tmp_path: Path) -> None:
    """Errors of the poses against those of the true parameters and true coordinates, in standard errors."""
    scores = []
    for seed in range(4):
        path = tmp_path / f"{seed}.mcap"
        truth = simulate(load_rig(name), rig_text(name)[0], path, seed=seed)
        solution = solve(read_recording(path), poses=30)
        calibration = Calibration.of(solution.rig, json.loads(json.dumps(result(solution))))
        table = average(read_recording(path))
        unused = np.setdiff1d(np.arange(len(table.counts)), solution.selection.poses)
        got = calibration.end_poses(table.counts[unused], table.sigma[unused])
        # What really was: the true parameters, and coordinates so well known that their noise is nothing.
        true = np.array([truth.parameters[p.name] for p in calibration.space.table])
        observed = Observations(table.counts[unused], table.sigma[unused])
        at = assemble(calibration.model, observed, true)
        real = settle(calibration.model, observed, at, true, calibration.space.expansion)
        end = calibration.model.end_pose(real.coordinates, true, calibration.space.expansion)
        turned = logarithm(got.rotation @ np.swapaxes(end.rotation, 1, 2))
        error = np.concatenate([got.position - end.position, turned], axis=1)
        spread = np.sqrt(np.diagonal(got.covariance, axis1=1, axis2=2))
        shown = spread[0] > 0
        scores.append(error[:, shown] / spread[:, shown])
    rms = np.sqrt(np.mean(np.concatenate(scores) ** 2))
    # The reference shares the readings, so it cannot be worse than stated, only better.
    assert 0.3 < rms < 1.3


def test_the_command_writes_poses_rig_and_corrections(loopcal: Run, tmp_path: Path) -> None:
    recording, found = tmp_path / "arm.mcap", tmp_path / "result.json"
    assert loopcal("simulate", "arm", "-o", recording, "--poses", 20).exit_code == 0
    assert loopcal("solve", recording, "--json", found).exit_code == 0
    outcome = loopcal(
        "apply", found, recording, "-o", tmp_path / "poses.csv",
        "--rig-out", tmp_path / "rig.toml", "--corrections", tmp_path / "channels.json",
    )  # fmt: skip
    assert outcome.exit_code == 0, outcome.stderr
    with (tmp_path / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    assert float(rows[0]["se_x_m"]) > 0

    estimates = {p["name"]: p for p in json.loads(found.read_text())["parameters"]}
    text = (tmp_path / "rig.toml").read_text()
    assert "# Giugovaz & Hollerbach" in text  # comments are kept
    calibrated = {p.name: p for p in parameters(load_rig(str(tmp_path / "rig.toml")))}
    for name, entry in estimates.items():
        p = calibrated[name]
        assert p.nominal / p.to_si == pytest.approx(entry["value"], rel=1e-8, abs=1e-12)
        if entry["identified"]:
            assert p.uncertainty is not None
            assert p.uncertainty / p.to_si == pytest.approx(entry["standard_error"], rel=1e-3)

    channels = json.loads((tmp_path / "channels.json").read_text())["channels"]
    assert [c["name"] for c in channels] == [f"q{k}" for k in range(1, 8)]
    assert channels[2]["theta_offset"] == pytest.approx(estimates["joint3.theta_offset"]["value"])


def test_a_result_of_another_rig_is_refused(loopcal: Run, tmp_path: Path) -> None:
    for name in ("arm", "shoulder"):
        assert (
            loopcal("simulate", name, "-o", tmp_path / f"{name}.mcap", "--poses", 15).exit_code == 0
        )
    assert (
        loopcal("solve", tmp_path / "shoulder.mcap", "--json", tmp_path / "r.json").exit_code == 0
    )
    outcome = loopcal("apply", tmp_path / "r.json", tmp_path / "arm.mcap")
    assert outcome.exit_code == 2
    assert "hinge.theta_offset" in " ".join(outcome.stderr.split())
    (tmp_path / "no.json").write_text("{}")
    outcome = loopcal("apply", tmp_path / "no.json", tmp_path / "arm.mcap")
    assert outcome.exit_code == 2
    assert "not a result file" in " ".join(outcome.stderr.split())
