"""Rigs with effects, played by nature in its own forms, calibrated from the recording alone."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from loopcal.applying import channel_corrections, run_apply
from loopcal.solving import run_solve
from recordings.reader import Recording, read_recording
from recordings.rig import DescribedEffect, Quantity, Rig, load_rig, parameters, parse_rig, rig_text
from recordings.rig.edit import with_effect
from sim_devices.simulate import simulate
from solver.calibration import Calibration
from solver.drives import held_joints
from solver.effects.needs import needs
from solver.errors import NotEnoughData
from solver.estimate.identifiability import plausible_error, undetermined
from solver.estimate.trust_region import Status
from solver.mechanism.space import ParameterSpace
from solver.motion import with_motion
from solver.rig_check import check_rig
from solver.samples import average
from solver.solve import Solution, solve


def free(value: float, dimension: str) -> Quantity:
    return Quantity(value, dimension, None, identify=True)


NONLINEAR = DescribedEffect(
    "nonlinearity",
    "q6",
    {f"p{n}": free(0.0, "angle") for n in range(2, 7)}
    | {"low": Quantity(-1.5, "angle"), "high": Quantity(1.1, "angle")},
)
GAIN = DescribedEffect("gain-error", "d1", {"ratio": free(0.0, "ratio")})
LAG = DescribedEffect("lag", "q6", {"delay": free(0.0, "time")})
SPRING = DescribedEffect(
    "joint-compliance", "joint5", {"compliance": free(0.0, "angular compliance")}
)

BEARING = DescribedEffect(
    "bearing-compliance", "joint2", {"compliance": free(0.0, "angular compliance")}
)


@cache
def recording(folder: Path, rig: str, hide: str) -> Recording:
    path = folder / f"{rig}-{hide.partition('@')[0]}.mcap"
    simulate(load_rig(rig), rig_text(rig)[0], path, seed=5, hide=(hide,) if hide else ())
    return read_recording(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


def grown(rig: Rig, effect: DescribedEffect) -> Rig:
    return rig.model_copy(update={"effects": (effect,)})


def solved(recorded: Recording, effect: DescribedEffect) -> Solution:
    out = solve(replace(recorded, rig=grown(recorded.rig, effect)), poses=10_000)
    assert out.estimate.status is Status.CONVERGED
    return out


def estimated(solution: Solution, name: str) -> tuple[float, float]:
    k = solution.estimate.space.names.index(name)
    full = solution.estimate.space.identified[k]
    return float(solution.estimate.parameters[full]), float(
        np.sqrt(solution.estimate.covariance[k, k])
    )


def test_a_nonlinearity_is_taken_up(folder: Path) -> None:
    hidden = recording(folder, "arm", "nonlinearity@q6=1%")
    plain = solve(hidden, poses=10_000).estimate.misfit
    assert solved(hidden, NONLINEAR).estimate.misfit < 0.02 * plain


def test_a_gain_error_is_measured(folder: Path) -> None:
    found = solved(recording(folder, "shoulder", "gain-error@d1=1%"), GAIN)
    ratio, error = estimated(found, "gain-error@d1.ratio")
    assert abs(ratio - 0.01) < 4 * error
    assert error < 0.003


def test_a_lag_shows_in_readings_between_the_dwells(folder: Path) -> None:
    found = solved(recording(folder, "arm", "lag@q6=0.02"), LAG)
    delay, error = estimated(found, "lag@q6.delay")
    assert abs(delay - 0.02) < 4 * error
    assert error < 1e-3
    assert found.estimate.misfit < 1.3


def test_without_a_lag_readings_in_motion_fit_as_those_at_rest_do(folder: Path) -> None:
    clean = recording(folder, "arm", "")
    dwells = average(clean)
    table, at = with_motion(clean, dwells)
    assert at.rate is not None
    moving = at.rate.any(axis=1)
    assert moving.sum() == len(table.counts) - len(dwells.counts)
    assert moving.sum() > 20
    delay, error = estimated(solved(clean, LAG), "lag@q6.delay")
    assert abs(delay) < 4 * error


def test_a_compliant_joint_is_measured_by_its_own_weight(folder: Path) -> None:
    hidden = recording(folder, "arm", "joint-compliance@joint5=0.02")
    found = solved(hidden, SPRING)
    compliance, _ = estimated(found, "joint-compliance@joint5.compliance")
    # Nature's spring hardens; the size is that of its best straight line.
    assert compliance == pytest.approx(np.deg2rad(0.02), rel=0.02)
    held = held_joints(hidden, found.table.windows)
    assert held is not None
    assert set(np.flatnonzero(held.all(axis=0))) == {5, 6}
    assert set(np.flatnonzero(held.any(axis=0))) == {5, 6}


@pytest.mark.parametrize("standing", ["on-drives", "gravity-compensated"])
def test_a_bearing_is_measured_by_what_leans_on_it(folder: Path, standing: str) -> None:
    text = rig_text("arm")[0].replace(
        'family = "serial"', f'family = "serial"\nstanding = "{standing}"', 1
    )
    path = folder / f"bearing-{standing}.mcap"
    hide = ("bearing-compliance@joint2=0.02",)
    simulate(parse_rig(text), text, path, seed=5, hide=hide)
    found = solved(read_recording(path), BEARING)
    compliance, error = estimated(found, "bearing-compliance@joint2.compliance")
    # Nature's bearing hardens; the size is that of its best straight line.
    assert compliance == pytest.approx(np.deg2rad(0.02), rel=0.02, abs=4 * error)
    assert error < 0.1 * compliance


def test_a_spring_that_is_as_uncertain_as_stiff_is_held_by_what_is_stated() -> None:
    """Rigs state compliances so: a spring gives way, and never the other way."""
    stated = Quantity(2e-5, "angular compliance", 2e-5, identify=True)
    spring = DescribedEffect("joint-compliance", "joint5", {"compliance": stated})
    space = ParameterSpace.of(parameters(grown(load_rig("arm"), spring)))
    k = space.names.index("joint-compliance@joint5.compliance")
    assert plausible_error(space)[k] == pytest.approx(2e-4)
    known = np.diag(1e3 / plausible_error(space))
    known[k] = 0.0
    assert undetermined(space, known)[0].shape[1] == 1
    known[k, k] = 1.0 / 2e-5
    assert undetermined(space, known)[0].shape[1] == 0


def test_what_a_recording_cannot_show_is_refused_in_words(folder: Path) -> None:
    clean = recording(folder, "arm", "")
    weightless = replace(clean, rig=grown(clean.rig.model_copy(update={"gravity": None}), SPRING))
    with pytest.raises(NotEnoughData, match=r"joint-compliance@joint5.*gravity_m_per_s2"):
        solve(weightless)


def test_check_and_needs_know_the_effects(folder: Path) -> None:
    rig = grown(load_rig("arm"), SPRING)
    assert needs(rig) == {"torque"}
    assert needs(load_rig("arm")) == frozenset()
    found = check_rig(rig)
    assert "joint-compliance@joint5.compliance" in found.identified
    assert not any("joint-compliance" in remark for remark in found.remarks)


def test_results_of_a_rig_with_effects_are_written_and_put_to_use(folder: Path) -> None:
    rig = folder / "grown.toml"
    rig.write_text(with_effect(rig_text("arm")[0], NONLINEAR), "utf-8")
    path, result, page = folder / "g.mcap", folder / "g.json", folder / "g.html"
    simulate(load_rig(str(rig)), rig.read_text("utf-8"), path, seed=2, poses=40)
    assert run_solve(
        path,
        poses=50,
        method=None,
        loss="none",
        use_priors=False,
        criterion="sigma_L",
        json_file=result,
        report=page,
        truth=None,
    )
    document = json.loads(result.read_text("utf-8"))
    names = [entry["name"] for entry in document["parameters"]]
    assert "nonlinearity@q6.p2" in names
    assert "nonlinearity@q6.p2" in page.read_text("utf-8")
    out, poses = folder / "calibrated.toml", folder / "poses.csv"
    run_apply(result, path, output=poses, rig_out=out, corrections=folder / "corrections.json")
    assert load_rig(str(out)).effects[0].values["p2"].uncertainty is not None
    (channel,) = (
        entry
        for entry in json.loads((folder / "corrections.json").read_text("utf-8"))["channels"]
        if entry["name"] == "q6"
    )
    assert len(channel["correction"]["read"]) == len(channel["correction"]["true"])


def test_what_no_channel_can_undo_is_not_exported(folder: Path) -> None:
    rig = grown(load_rig("arm"), SPRING)
    found = solve(replace(recording(folder, "arm", "joint-compliance@joint5=0.02"), rig=rig))
    calibration = Calibration(
        found.model, found.estimate.space, found.estimate.parameters, found.estimate.covariance
    )
    with pytest.raises(NotEnoughData, match="cannot be undone by a table"):
        channel_corrections(rig, calibration)
