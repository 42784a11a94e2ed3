"""Errors that neighbouring poses share are seen and widen the intervals; noise alone is let alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from solver.estimate import likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.nuisance import Observations
from tests.solver.synthetic import solution

Array = NDArray[np.float64]


def _again(
    name: str, shared: float, seed: int, poses: int | None = None, visits: int = 1
) -> Estimate:
    """The bundled rig from readings that close, with noise, and errors that vary with the pose.

    ``poses`` of those selected, all by default, ``visits`` times each with noise of its own.
    """
    solved = solution(name)
    rng = np.random.default_rng([seed, 23])
    chosen = np.tile(solved.selection.poses[:poses], visits)
    at = solved.model.linearise(
        solved.after.coordinates[chosen],
        solved.estimate.parameters,
        np.zeros((len(solved.estimate.parameters), 0)),
    )
    sigma = solved.table.sigma[chosen]
    where = at.readings / at.readings.std(axis=0)
    directions = rng.standard_normal((where.shape[1], where.shape[1])) / np.sqrt(where.shape[1])
    slow = np.sqrt(2) * np.sin(2.5 * where @ directions + rng.uniform(0, 6, where.shape[1]))
    counts = at.readings + sigma * (rng.standard_normal(sigma.shape) + shared * slow)
    return likelihood.identify(solved.model, solved.estimate.space, Observations(counts, sigma))


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_noise_alone_is_not_taken_for_more(name: str) -> None:
    found = [_again(name, 0.0, seed).correlation for seed in range(8)]
    scores = np.array([c.score for c in found if c is not None])
    assert len(scores) == 8
    assert abs(scores.mean()) < 1.1  # three standard errors of a mean of eight
    assert 0.3 < scores.std() < 2.0
    assert all(not c.widening.any() for c in found if c is not None)


@pytest.mark.parametrize("name", ["arm", "shoulder"])
@pytest.mark.parametrize(("poses", "visits"), [(20, 5)])
def test_poses_visited_again_with_noise_of_their_own_share_nothing(
    name: str, poses: int, visits: int
) -> None:
    found = [_again(name, 0.0, seed, poses, visits).correlation for seed in range(4)]
    scores = np.array([c.score for c in found if c is not None])
    assert len(scores) == 4
    assert abs(scores.mean()) < 2.0
    assert all(not c.widening.any() for c in found if c is not None)


def test_visits_share_what_the_model_lacks_at_their_pose() -> None:
    found = _again("arm", 3.0, 1, 20, 3).correlation
    assert found is not None
    assert found.significant
    assert found.widening.any()


def test_errors_that_neighbours_share_are_seen_and_widen_the_intervals() -> None:
    found = _again("arm", 3.0, 1)
    assert found.correlation is not None
    assert found.correlation.significant
    alone = np.sqrt(np.diag(found.covariance)) * found.inflation
    assert (found.standard_errors >= alone).all()
    assert (found.standard_errors > 1.1 * alone).any()
    assert np.linalg.eigvalsh(found.correlation.widening).min() > -1e-12 * np.trace(
        found.correlation.widening
    )
