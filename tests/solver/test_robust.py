"""Robust weights settle where refitting with them gives them back, also where poses have high leverage."""

from __future__ import annotations

import numpy as np
import pytest

from solver.estimate.robust import Loss, reweighted

POSES, CHANNELS, COUNT = 60, 3, 60


@pytest.mark.parametrize("loss", [Loss.HUBER, Loss.CAUCHY])
@pytest.mark.parametrize("seed", range(2))
def test_weights_are_those_of_the_fit_that_they_give(loss: Loss, seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    jacobian = (
        rng.standard_normal((POSES, CHANNELS, COUNT))
        * np.exp(rng.normal(0, 1, POSES))[:, None, None]
    )
    noise = rng.standard_normal((POSES, CHANNELS))
    noise[:6] *= 8.0
    flat, held = jacobian.reshape(-1, COUNT), np.eye(COUNT)
    beside = rng.standard_normal(COUNT), held

    def fitted(weight: np.ndarray) -> np.ndarray:
        root = np.sqrt(np.repeat(weight, CHANNELS))[:, None]
        rows, right = (
            np.vstack([flat * root, held]),
            np.append(noise.ravel() * root[:, 0], beside[0]),
        )
        step = -np.linalg.lstsq(rows, right, rcond=None)[0]
        return np.asarray(noise + (flat @ step).reshape(POSES, CHANNELS))

    residual = fitted(np.ones(POSES))
    start = -np.linalg.lstsq(
        np.vstack([flat, held]), np.append(noise.ravel(), beside[0]), rcond=None
    )[0]
    at_fit = (beside[0] + start, held)
    weight, usual = reweighted(loss, residual, jacobian, at_fit, np.ones(POSES), CHANNELS)
    again = loss.weight(np.sqrt(np.sum(fitted(weight) ** 2, axis=1) / usual), CHANNELS)
    np.testing.assert_allclose(weight, again, atol=2e-3)
    assert weight.min() < 0.5
