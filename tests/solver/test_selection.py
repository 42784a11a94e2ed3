"""Selection: exact size, certified bounds, and better than chance by every criterion."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from recordings.rig import load_rig, parameters
from solver.errors import SolverError
from solver.estimate.nuisance import Observations, settle
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.criteria import CRITERIA, Criterion, criterion_named, uphill, worth
from solver.poses.selection import select
from solver.poses.wander import wander

Array = NDArray[np.float64]


@cache
def jacobians(name: str, poses: int = 450) -> Array:
    rig = load_rig(name)
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    u = wander(rig, model, space.nominal, poses, seed=1)
    at = model.linearise(u, space.nominal, space.expansion)
    observed = Observations(at.readings, np.ones_like(at.readings))
    return settle(model, observed, u, space.nominal, space.expansion).jacobian


def value_of(criterion: Criterion, rows: Array) -> float:
    information = np.einsum("pen,pem->nm", rows, rows)
    return float(np.sqrt(worth(criterion, information)))


@pytest.mark.parametrize(("name", "gap"), [("arm", 0.005), ("shoulder", 0.03)])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_fifty_of_450_come_near_the_bound(name: str, gap: float, criterion: Criterion) -> None:
    rows = jacobians(name)
    chosen = select(rows, 50, criterion)
    assert len(set(chosen.poses.tolist())) == 50
    assert chosen.value == pytest.approx(
        value_of(criterion, rows[chosen.poses] * chosen.scale), rel=1e-6
    )
    assert (1 - gap) * chosen.upper_bound <= chosen.value <= chosen.upper_bound
    rng = np.random.default_rng(3)
    chance = [
        value_of(criterion, rows[rng.choice(450, 50, replace=False)] * chosen.scale)
        for _ in range(20)
    ]
    assert chosen.value > max(chance)


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_bound_holds_for_every_set(criterion: Criterion, seed: int) -> None:
    rows = np.random.default_rng(seed).standard_normal((11, 2, 3)) * [1.0, 3.0, 0.3]
    chosen = select(rows, 4, criterion)
    best = max(
        value_of(criterion, rows[list(sets)] * chosen.scale) for sets in combinations(range(11), 4)
    )
    assert best <= chosen.upper_bound * (1 + 1e-9)
    assert chosen.value >= 0.9 * best


@pytest.mark.parametrize("criterion", CRITERIA)
def test_no_unit_changes_the_choice(criterion: Criterion) -> None:
    rows = np.random.default_rng(5).standard_normal((40, 2, 3))
    first = select(rows, 10, criterion)
    other = select(rows * [1e3, 1.0, 1e-3], 10, criterion)
    assert first.poses.tolist() == other.poses.tolist()
    assert other.value == pytest.approx(first.value)


@pytest.mark.parametrize("criterion", ["determinant", "trace"])
def test_uphill_is_the_gradient(criterion: Criterion) -> None:
    rng = np.random.default_rng(2)
    root, step = rng.standard_normal((4, 4)), rng.standard_normal((4, 4))
    at, step = root @ root.T + np.eye(4), step + step.T
    numeric = (worth(criterion, at + 1e-6 * step) - worth(criterion, at - 1e-6 * step)) / 2e-6
    assert np.sum(uphill(criterion, at) * step) == pytest.approx(float(numeric), rel=1e-6)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_a_direction_that_no_pose_shows_is_worth_nothing(criterion: Criterion) -> None:
    rows = np.random.default_rng(1).standard_normal((30, 2, 3))
    rows[:, :, 2] = rows[:, :, 1]
    chosen = select(rows, 10, criterion)
    assert len(chosen.poses) == 10
    assert chosen.value == pytest.approx(0.0, abs=1e-3)


def test_takes_all_when_there_are_no_more() -> None:
    rows = np.random.default_rng(0).standard_normal((5, 2, 3))
    chosen = select(rows, 8)
    assert chosen.poses.tolist() == [0, 1, 2, 3, 4]
    assert chosen.value == chosen.upper_bound


def test_refuses_what_cannot_be_chosen() -> None:
    with pytest.raises(SolverError, match="cannot choose 0 of 5"):
        select(np.ones((5, 2, 3)), 0)
    with pytest.raises(SolverError, match="sigma_L, determinant, trace, condition"):
        criterion_named("sharpe")
