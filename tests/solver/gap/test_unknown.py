"""Patterns without a name: what moves and swings leave behind is seen, and noise is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.analysis import first_fit
from solver.gap.channels import disagreement, moved
from solver.gap.fit import Fit
from solver.gap.unknown import Pattern, followed, unknown
from solver.samples import average


def fitted(folder: Path, *hide: str) -> Fit:
    text, source = rig_text("shoulder")
    simulate(parse_rig(text, source), text, folder / "r.mcap", seed=2, hide=hide)
    recording = read_recording(folder / "r.mcap")
    return first_fit(recording, average(recording))


def test_noise_shows_no_pattern(tmp_path: Path) -> None:
    assert unknown(fitted(tmp_path), np.random.default_rng(1)).p > 0.01


@pytest.mark.parametrize(
    ("hide", "over"),
    [
        ("outsider:creep@d2=0.4%", {"move"}),
        ("outsider:swinging-offset@d1=0.15e-3", {"time", "swing"}),
    ],
)
def test_what_moves_and_swings_leave_is_seen(tmp_path: Path, hide: str, over: set[str]) -> None:
    fit = fitted(tmp_path, hide)
    seen = unknown(fit, np.random.default_rng(1))
    assert seen.p < 0.01
    first = seen.patterns[0]
    assert first.over in over
    assert first.channel == hide.partition("@")[2].partition("=")[0]
    assert seen.strangest(3)[0] is first
    assert len({(p.channel, p.over) for p in seen.strangest(9)}) == 9
    # With the sign and the size that nature has.
    shown = followed(fit, first)
    assert shown is not None
    moved = np.array([0.15e-3, 0.4e-2 * np.std(shown.along)])[int("move" in over)]
    assert 0.3 * moved < np.std(shown.seen) < 1.5 * moved
    against = disagreement(fit)
    c = against.channels.index(first.channel)
    assert np.corrcoef(shown.seen, against.difference[:, c])[0, 1] > 0.1
    assert np.isfinite(shown.beside).all()
    if "move" in over:
        assert np.corrcoef(shown.along, shown.seen)[0, 1] < -0.5  # it is behind


def test_a_pattern_over_the_pose_is_no_line(tmp_path: Path) -> None:
    fit = fitted(tmp_path)
    assert followed(fit, Pattern("d1", "pose", 0, -1.0, 1.0)) is None


def test_a_channel_that_stood_still_is_no_measure_of_the_pose(tmp_path: Path) -> None:
    """What is fitted to it is its own error, which would seem to go with itself."""
    fit = fitted(tmp_path)
    assert moved(fit).all()
    sigma = fit.observed.sigma.copy()
    sigma[:, 0] = np.std(fit.observed.counts[:, 0])
    still = replace(fit, observed=replace(fit.observed, sigma=sigma))
    assert moved(still).tolist() == [False, True, True, True]
    groups = {(p.channel, p.over) for p in unknown(still, np.random.default_rng(1)).patterns}
    assert ("d1", "time") in groups
    assert ("d1", "move") not in groups
    assert ("d2", "move") in groups
