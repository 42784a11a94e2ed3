"""The sample recordings: small, reproducible, and solving to their truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from solver.solve import solve

SAMPLES = Path(__file__).parents[2] / "recordings" / "samples"


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_a_sample_solves_to_its_truth(name: str) -> None:
    assert (SAMPLES / f"{name}.mcap").stat().st_size < 2_000_000
    truth = json.loads((SAMPLES / f"{name}.truth.json").read_text())["parameters"]
    estimate = solve(read_recording(SAMPLES / f"{name}.mcap")).estimate
    table = {parameter.name: parameter for parameter in estimate.space.table}
    scores = [
        (value / table[name].to_si - truth[name]) / (error / table[name].to_si)
        for name, value, error in zip(
            estimate.space.names, estimate.values, estimate.standard_errors, strict=True
        )
    ]
    assert np.abs(scores).max() < 4
    assert estimate.misfit < 1.5
