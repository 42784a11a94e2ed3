"""The two published systems, from a simulated session to a solution, over twenty seeds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.solve import Solution, solve

SEEDS = range(20)


@dataclass(frozen=True)
class Run:
    """One solved session, and the error of every parameter in its own standard errors."""

    solution: Solution
    scores: np.ndarray


def run(rig: str, seed: int, folder: Path, *hide: str) -> Run:
    path = folder / f"{rig}-{seed}-{len(hide)}.mcap"
    truth = simulate(load_rig(rig), rig_text(rig)[0], path, seed=seed, hide=hide)
    solution = solve(read_recording(path))
    path.unlink()
    estimate = solution.estimate
    true = np.array([truth.parameters[name] for name in estimate.space.names])
    return Run(solution, (estimate.values - true) / estimate.standard_errors)


@pytest.fixture(scope="module", params=["arm", "shoulder"])
def runs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    folder = tmp_path_factory.mktemp("published")
    return [run(request.param, seed, folder) for seed in SEEDS]


def test_the_truth_is_found_within_its_standard_errors(runs: list[Run]) -> None:
    scores = np.array([each.scores for each in runs])
    unknowns = scores.shape[1]
    assert unknowns in (14, 7)
    assert (np.abs(scores) < 2.6).sum(axis=1).mean() >= unknowns * 13 / 14
    # Honest both ways: errors are neither larger nor much smaller than stated.
    assert 0.75 < np.sqrt(np.mean(scores**2)) < 1.25


def test_noise_explains_what_is_left(runs: list[Run]) -> None:
    assert np.mean([each.solution.estimate.misfit for each in runs]) == pytest.approx(1.0, abs=0.15)


def test_fifty_poses_are_used_and_well_conditioned(runs: list[Run]) -> None:
    for each in runs:
        assert len(each.solution.selection.poses) == 50
        assert each.solution.selection.value <= each.solution.selection.upper_bound
        if each.solution.rig.name == "arm":
            assert each.solution.scaled.condition <= 28


def test_closure_of_a_linear_arm_is_what_sensor_noise_predicts(tmp_path: Path) -> None:
    ratios = []
    for seed in range(5):
        closure = run("arm", seed, tmp_path).solution.closure_after
        assert closure is not None
        ratios.append(closure.position_rms / closure.position_predicted)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)


def test_closure_with_bent_rvdts_is_of_the_papers_order(tmp_path: Path) -> None:
    bent = run("arm", 3, tmp_path, "nonlinearity@q6=2%", "nonlinearity@q7=2%").solution
    assert bent.closure_after is not None
    assert 0.5e-3 < bent.closure_after.position_rms < 10e-3
    assert bent.estimate.misfit > 100  # and the solution says that something is missing
    assert bent.estimate.inflation == pytest.approx(np.sqrt(bent.estimate.misfit))


@pytest.mark.parametrize(("rig", "method"), [("arm", "hinge"), ("shoulder", "multi-loop")])
def test_the_papers_methods_are_honest_too(rig: str, method: str, tmp_path: Path) -> None:
    scores = []
    for seed in range(8):
        solution = run(rig, seed, tmp_path).solution
        assert [other.method for other in solution.beside] == [method]
        scores.append(
            (solution.beside[0].values - solution.estimate.values)
            / solution.beside[0].standard_errors
        )
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
