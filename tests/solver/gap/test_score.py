"""F tails far out, and evidence that weighs what is plausible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import f

from loopcal.blind.grid import rig_of
from recordings.reader import read_recording
from recordings.rig import parse_rig
from sim_devices.simulate import simulate
from solver.gap.analysis import first_fit
from solver.gap.candidates import candidates
from solver.gap.score import forms, log_f_tail, log_sum
from solver.gap.screen import Threshold, screen
from solver.samples import average


@pytest.mark.parametrize("width", [1, 2, 5, 8])
@pytest.mark.parametrize("explained", [0.001, 0.05, 0.3, 0.7, 0.9])
def test_tail_is_that_of_f(width: int, explained: float) -> None:
    freedoms = 380
    ratio = explained / width / ((1 - explained) / (freedoms - width))
    expected = f.logsf(ratio, width, freedoms - width)
    got = log_f_tail(np.array([explained]), np.array([width]), 1.0, freedoms)[0]
    assert got == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_tail_orders_what_would_underflow() -> None:
    explained = 1.0 - np.array([1e-3, 1e-4, 1e-5])
    got = log_f_tail(explained, np.array([2, 2, 2]), 1.0, 1000)
    assert np.isfinite(got).all()
    assert (np.diff(got) < -900).all()


def test_log_sum_is_exact_where_exponentials_overflow() -> None:
    assert log_sum(np.array([1000.0, 1000.0])) == pytest.approx(1000.0 + np.log(2.0))


def test_turns_that_a_ball_does_not_feel_give_a_slip_no_direction(tmp_path: Path) -> None:
    text = rig_of("wrist")
    rig = parse_rig(text, "wrist")
    simulate(rig, text, tmp_path / "w.mcap", seed=4, poses=20)
    recording = read_recording(tmp_path / "w.mcap")
    fit = first_fit(recording, average(recording))
    tested = [c for c in candidates(fit)[0] if c.name == "fixture-slip"]
    assert tested
    assert {form.basis.shape[1] for form in forms(fit, tested)} <= {0, 1, 2, 3}


def test_a_warm_up_is_screened_by_its_speed_alone_and_shares_evidence_with_a_line(
    tmp_path: Path,
) -> None:
    text = rig_of("shoulder")
    simulate(parse_rig(text), text, tmp_path / "s.mcap", seed=4, poses=30)
    recording = read_recording(tmp_path / "s.mcap")
    fit = first_fit(recording, average(recording))
    tested = [c for c in candidates(fit)[0] if c.label == "offset-drift@d1"]
    found = forms(fit, tested)
    assert [len(form.effect.coefficients) for form in found] == [1, 2, 2, 2, 2, 2]
    assert {form.basis.shape[1] for form in found} == {1}
    # Of forms that explain nothing, the line has half of the evidence, and is what would be named.
    nothing = [replace(form, basis=form.basis[:, :0]) for form in found]
    seen = screen(fit, nothing, ["offset-drift@d1"], Threshold({}, np.zeros(1)))
    assert seen.best_form.tolist() == [0]
    assert seen.log_evidence[0] == pytest.approx(0.0)
