"""Maximum likelihood: invariances, agreement with an independent formulation, honest uncertainty, robustness."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares
from scipy.stats import chi2

from recordings.rig import load_rig, parameters
from solver.errors import MethodError
from solver.estimate import likelihood, multi_loop
from solver.estimate.estimate import Estimate
from solver.estimate.nuisance import Observations
from solver.estimate.robust import Loss
from solver.estimate.trust_region import Status
from solver.mechanism.model import Linearised, Model, model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import close, wander
from solver.solve import solve_table
from tests.solver.synthetic import pose_table, true_parameters

Array = NDArray[np.float64]

RIGS = ("arm", "shoulder")
_CLOSED = 1e-8  # m or rad: closure errors that weigh as much as a standard deviation of a reading


@cache
def _rig(name: str) -> tuple[Model, ParameterSpace]:
    return model_of(load_rig(name)), ParameterSpace.of(parameters(load_rig(name)))


def _observed(name: str, *, seed: int = 1, poses: int = 24) -> Observations:
    table = pose_table(name, seed=seed, poses=poses)
    return Observations(table.counts, table.sigma)


@pytest.mark.parametrize("name", RIGS)
def test_the_order_of_poses_does_not_matter(name: str) -> None:
    model, space = _rig(name)
    observed = _observed(name)
    shuffled = observed.take(np.random.default_rng(0).permutation(len(observed.counts)))
    first, second = (likelihood.identify(model, space, o) for o in (observed, shuffled))
    np.testing.assert_allclose(second.values, first.values, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(second.standard_errors, first.standard_errors, rtol=1e-4)


@pytest.mark.parametrize("name", RIGS)
def test_the_order_of_channels_does_not_matter(name: str) -> None:
    rig = load_rig(name)
    order = np.arange(len(rig.channels))[::-1]
    turned = rig.model_copy(update={"channels": tuple(rig.channels[i] for i in order)})
    observed = _observed(name)
    model, space = _rig(name)
    first = likelihood.identify(model, space, observed)
    second = likelihood.identify(
        model_of(turned),
        ParameterSpace.of(parameters(turned)),
        Observations(observed.counts[:, order], observed.sigma[:, order]),
    )
    of_second = dict(zip(second.space.names, second.values, strict=True))
    for name_of, value in zip(first.space.names, first.values, strict=True):
        assert of_second[name_of] == pytest.approx(value, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_the_unit_of_length_does_not_matter(name: str, factor: float) -> None:
    model, space = _rig(name)
    observed = _observed(name)
    table = tuple(
        replace(
            p,
            nominal=factor * p.nominal,
            uncertainty=None if p.uncertainty is None else factor * p.uncertainty,
        )
        if p.dimension.startswith("length")
        else p
        for p in space.table
    )
    longer = replace(space, table=table)
    first = likelihood.identify(model, space, observed)
    second = likelihood.identify(model, longer, observed)
    scale = np.array(
        [factor if space.table[i].dimension.startswith("length") else 1.0 for i in space.identified]
    )
    assert second.misfit == pytest.approx(first.misfit, rel=1e-5)
    within = 1e-3 * first.standard_errors
    assert (np.abs(second.values / scale - first.values) < within).all()
    np.testing.assert_allclose(second.standard_errors / scale, first.standard_errors, rtol=1e-3)


def test_a_zero_count_elsewhere_only_moves_the_readings() -> None:
    rig = load_rig("shoulder")
    moved = rig.model_copy(
        update={
            "channels": tuple(
                c.model_copy(update={"zero_count": c.zero_count + 700}) for c in rig.channels
            )
        }
    )
    observed = _observed("shoulder")
    first = likelihood.identify(*_rig("shoulder"), observed)
    second = likelihood.identify(
        model_of(moved),
        ParameterSpace.of(parameters(moved)),
        replace(observed, counts=observed.counts + 700),
    )
    np.testing.assert_allclose(second.values, first.values, rtol=1e-9)


@pytest.mark.parametrize("name", RIGS)
def test_agrees_with_all_unknowns_solved_at_once(name: str) -> None:
    """Parameters and every pose's true coordinates side by side in scipy's least squares, closure nearly exact."""
    model, space = _rig(name)
    poses = 6 if name == "arm" else 9
    observed = _observed(name, poses=poses, seed=4)
    ours = likelihood.identify(model, space, observed)
    count, size = len(space.names), ours.coordinates.shape[1]
    width = np.concatenate([ours.standard_errors, np.full(poses * size, 1e-3)])
    rng = np.random.default_rng(0)
    start = np.concatenate(
        [0.5 * rng.standard_normal(count), 1e-2 * rng.standard_normal(poses * size)]
    )

    def at(unknowns: Array) -> Linearised:
        moved = unknowns * width
        x = space.expand(ours.values + moved[:count])
        return model.linearise(
            ours.coordinates + moved[count:].reshape(poses, size), x, space.expansion
        )

    def residual(unknowns: Array) -> Array:
        found = at(unknowns)
        misread = (found.readings - observed.counts) / observed.sigma
        return np.concatenate([misread.ravel(), found.closure.ravel() / _CLOSED])

    def slope(unknowns: Array) -> Array:
        found = at(unknowns)
        by_x = np.concatenate(
            [
                (found.readings_by_parameters / observed.sigma[:, :, None]).reshape(-1, count),
                found.closure_by_parameters.reshape(-1, count) / _CLOSED,
            ]
        )
        blocks = [
            block_diag(*(found.readings_by_coordinates / observed.sigma[:, :, None])),
            block_diag(*found.closure_by_coordinates) / _CLOSED,
        ]
        by_u = np.concatenate(blocks)[: len(by_x)]
        return np.hstack([by_x, by_u]) * width

    theirs = least_squares(residual, start, jac=slope, x_scale="jac", xtol=1e-14, ftol=1e-14)
    cost = float(ours.residual @ ours.residual)
    assert 2 * theirs.cost == pytest.approx(cost, rel=1e-4, abs=1e-4)
    assert np.abs(theirs.x[:count]).max() < 0.02  # standard errors


def _sessions(name: str, count: int, poses: int) -> list[tuple[Array, Estimate]]:
    """Truth (n,) and estimate of ``count`` seeded sessions with known noise."""
    rig = load_rig(name)
    model, space = _rig(name)
    reached = wander(rig, model, space.nominal, 3 * poses, seed=1)
    sigma = np.tile([c.noise / np.sqrt(40) for c in rig.channels], (poses, 1))
    out = []
    for seed in range(count):
        rng = np.random.default_rng([seed, 31])
        truth = true_parameters(rig, seed)
        some = rng.choice(len(reached), size=2 * poses, replace=False)
        found, closed = close(model, reached[some], truth)
        exact = model.linearise(found[closed][:poses], truth, space.expansion[:, :0]).readings
        observed = Observations(exact + sigma * rng.standard_normal(exact.shape), sigma)
        out.append((space.reduce(truth), likelihood.identify(model, space, observed)))
    return out


@pytest.mark.parametrize("name", RIGS)
def test_intervals_cover_and_misfit_is_chi_square(name: str) -> None:
    """A smoke test; `benchmarks/accuracy.py` measures it."""
    sessions = _sessions(name, 60, 20)
    normal = np.array([(e.values - t) / np.sqrt(np.diag(e.covariance)) for t, e in sessions])
    assert all(e.status is Status.CONVERGED for _, e in sessions)
    assert 0.90 <= np.mean(np.abs(normal) < 1.96) <= 0.99
    assert 0.85 <= np.sqrt(np.mean(normal**2)) <= 1.15
    freedoms = sessions[0][1].freedoms
    total = sum(e.misfit * freedoms for _, e in sessions)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 60 * freedoms)
    assert low < total < high
    below = np.mean([chi2.cdf(e.misfit * freedoms, freedoms) < 0.5 for _, e in sessions])
    assert 0.25 < below < 0.75


def test_degrees_of_freedom_are_redundant_readings_less_parameters() -> None:
    arm = likelihood.identify(*_rig("arm"), _observed("arm", poses=20))
    assert arm.freedoms == 20 * (7 - 2) - 14
    shoulder = likelihood.identify(*_rig("shoulder"), _observed("shoulder", poses=20))
    assert shoulder.freedoms == 20 * (4 - 3) - 7
    believed = likelihood.identify(
        *_rig("shoulder"), _observed("shoulder", poses=20), use_priors=True
    )
    assert believed.freedoms == 20 * (4 - 3) - 7 + 7


def test_priors_rule_where_the_data_say_little_and_yield_where_they_say_much() -> None:
    model, space = _rig("shoulder")
    few = likelihood.identify(model, space, _observed("shoulder", poses=3), use_priors=True)
    assert (few.standard_errors <= space.uncertainty * (1 + 1e-9)).all()
    assert few.standard_errors.max() > 0.3 * space.uncertainty.max()
    observed = _observed("shoulder", poses=60)
    with_them = likelihood.identify(model, space, observed, use_priors=True)
    without = likelihood.identify(model, space, observed)
    assert (np.abs(with_them.values - without.values) < 0.5 * without.standard_errors).all()


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("loss", [Loss.HUBER, Loss.CAUCHY])
def test_a_robust_loss_finds_the_bad_poses_and_the_truth(name: str, loss: Loss) -> None:
    model, space = _rig(name)
    observed = _observed(name, poses=40)
    counts = observed.counts.copy()
    bad = [3, 17, 22]  # poses that the others can check
    counts[bad, 1] += np.array([80.0, -60.0, 100.0]) * observed.sigma[bad, 1]
    spoilt = replace(observed, counts=counts)
    truth = space.reduce(true_parameters(load_rig(name), 1))
    plain = likelihood.identify(model, space, spoilt)
    robust = likelihood.identify(model, space, spoilt, loss=loss)
    clean = likelihood.identify(model, space, observed)

    def off(estimate: Estimate) -> float:
        return float(np.sqrt(np.mean(((estimate.values - truth) / clean.standard_errors) ** 2)))

    assert off(plain) > 3.0
    assert off(robust) < 2.0
    assert set(bad) <= set(robust.downweighted)
    assert len(robust.downweighted) <= len(bad) + 4


def test_without_bad_poses_a_robust_loss_changes_little() -> None:
    model, space = _rig("arm")
    observed = _observed("arm", poses=40)
    plain = likelihood.identify(model, space, observed)
    robust = likelihood.identify(model, space, observed, loss=Loss.HUBER)
    assert (np.abs(robust.values - plain.values) < plain.standard_errors).all()
    np.testing.assert_allclose(robust.standard_errors, plain.standard_errors, rtol=0.15)


def test_expected_misfit_of_a_weighted_fit() -> None:
    t = np.sqrt(np.random.default_rng(0).chisquare(5, 200_000) / 5)
    for loss in Loss:
        assert np.mean(loss.weight(t, 5) * t**2) == pytest.approx(loss.expected(5), rel=5e-3)


def test_only_maximum_likelihood_weighs_poses() -> None:
    table = pose_table("arm", poses=20)
    with pytest.raises(MethodError, match="need the method 'ml'"):
        solve_table(load_rig("arm"), table, method="hinge", loss=Loss.HUBER)


def test_multi_loop_ends_in_the_right_minimum() -> None:
    model, space = _rig("shoulder")
    for seed in range(6):
        found = multi_loop.identify(model, space, _observed("shoulder", seed=seed, poses=40))
        truth = space.reduce(true_parameters(load_rig("shoulder"), seed))
        assert found.status is Status.CONVERGED
        assert found.misfit < 3
        assert (np.abs(found.values - truth) < 5 * found.standard_errors).all()


def test_many_poses_are_worked_on_in_turn() -> None:
    """More poses than are taken at once: copies of a few, whose answer is that of the few.

    Copies share even their noise, which widens the standard errors, rightly; what noise alone
    would do is compared here. `test_correlation` has visits with noise of their own.
    """
    model, space = _rig("arm")
    few = _observed("arm", poses=20)
    many = few.take(np.arange(20 * 110) % 20)
    one, all_of_them = (likelihood.identify(model, space, o) for o in (few, many))
    assert (np.abs(all_of_them.values - one.values) < 1e-2 * one.standard_errors).all()
    np.testing.assert_allclose(
        np.sqrt(110 * np.diag(all_of_them.covariance)), np.sqrt(np.diag(one.covariance)), rtol=1e-2
    )


def test_the_arm_is_found_from_far() -> None:
    """A smoke test; `benchmarks/convergence.py` measures it."""
    model, space = _rig("arm")
    for seed in range(5):
        rng = np.random.default_rng([seed, 7])
        truth = true_parameters(load_rig("arm"), seed)
        largest = np.array(
            [
                np.radians(20) if n == "hinge.alpha" or n.endswith("theta_offset") else 0.02
                for n in space.names
            ]
        )
        start = space.expand(space.reduce(truth) + largest * rng.uniform(-1, 1, len(largest)))
        found = likelihood.identify(model, space, _observed("arm", seed=seed), start=start)
        errors = np.sqrt(np.diag(found.covariance))
        assert (np.abs(found.values - space.reduce(truth)) < 5 * errors).all()
