"""Patterns without a name: what moves and swings leave behind is seen, and noise is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.analysis import first_fit
from solver.gap.unknown import Unknown, unknown
from solver.samples import average


def found(folder: Path, *hide: str) -> Unknown:
    text, source = rig_text("shoulder")
    simulate(parse_rig(text, source), text, folder / "r.mcap", seed=2, hide=hide)
    recording = read_recording(folder / "r.mcap")
    return unknown(first_fit(recording, average(recording)), np.random.default_rng(1))


def test_noise_shows_no_pattern(tmp_path: Path) -> None:
    assert found(tmp_path).p > 0.01


@pytest.mark.parametrize(
    ("hide", "over"),
    [
        ("outsider:creep@d2=0.4%", {"move"}),
        ("outsider:swinging-offset@d1=0.15e-3", {"time", "swing"}),
    ],
)
def test_what_moves_and_swings_leave_is_seen(tmp_path: Path, hide: str, over: set[str]) -> None:
    seen = found(tmp_path, hide)
    assert seen.p < 0.01
    assert seen.patterns[0].over in over
