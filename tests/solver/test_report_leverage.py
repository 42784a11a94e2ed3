"""What noise alone leaves in each channel: the formula against repeated noise."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import load_rig
from solver.estimate.nuisance import Observations, settle
from solver.mechanism.model import model_of
from solver.report.leverage import expected_residuals
from tests.solver.synthetic import pose_table, solution, true_parameters


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_expected_residuals_are_what_noise_leaves(name: str) -> None:
    rig = load_rig(name)
    model, truth = model_of(rig), true_parameters(rig, 0)
    table, solved = pose_table(name, poses=8), solution(name)
    nowhere = np.zeros((len(truth), 0))
    start = solved.after.coordinates[:8]
    at = settle(model, Observations(table.counts, table.sigma), start, truth, nowhere).coordinates
    readings = model.linearise(at, truth, nowhere).readings
    rng = np.random.default_rng(2)
    squares = np.zeros_like(readings)
    draws = 400
    for _ in range(draws):
        counts = readings + table.sigma * rng.standard_normal(readings.shape)
        squares += (
            settle(model, Observations(counts, table.sigma), at, truth, nowhere).residual ** 2
        )
    expected = expected_residuals(model, table, at, truth)
    # A mean of 400 squares scatters by 7 %: 5 of that, and a floor for readings hardly checked.
    np.testing.assert_allclose(squares / draws, expected**2, rtol=0.35, atol=0.01)
    freedoms = readings.shape[1] - model.mobility(at, truth)
    np.testing.assert_allclose(np.sum(expected**2, axis=1), freedoms, rtol=1e-6)
