"""Derivatives of what the estimators minimise, against finite differences at seeded configurations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from recordings.rig import load_rig, parameters
from solver.estimate import hinge, multi_loop
from solver.estimate.gauss_newton import Closure
from solver.estimate.nuisance import Observations, assemble, settle
from solver.mechanism.model import model_of
from solver.mechanism.platform import PlatformModel
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from tests.solver.synthetic import pose_table, true_parameters

Array = NDArray[np.float64]


def _differences(of: Callable[[Array], Array], at: Array, step: Array) -> Array:
    """(..., n) central differences of ``of`` at ``at`` (n,)."""
    columns = []
    for j in range(len(at)):
        moved = np.zeros(len(at))
        moved[j] = step[j]
        columns.append((of(at + moved) - of(at - moved)) / (2 * step[j]))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_eliminated_residual_has_the_derivative_it_claims(name: str) -> None:
    model, space = model_of(load_rig(name)), ParameterSpace.of(parameters(load_rig(name)))
    table = pose_table(name, poses=8, seed=2)
    observed = Observations(table.counts, table.sigma)
    near = assemble(model, observed, space.nominal)
    z = space.reduce(space.nominal)

    def residual(at: Array) -> Array:
        settled = settle(model, observed, near, space.expand(at), space.expansion, tolerance=1e-10)
        return settled.residual

    found = settle(model, observed, near, space.nominal, space.expansion, tolerance=1e-10)
    slope = _differences(residual, z, np.full(len(z), 1e-6))
    # The Jacobian leaves out the curvature of each pose's search; the gradient of the cost is exact.
    gradient = np.einsum("pc,pcn->n", found.residual, found.jacobian)
    expected = np.einsum("pc,pcn->n", found.residual, slope)
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_coordinates_follow_the_parameters_as_claimed() -> None:
    model, space = model_of(load_rig("arm")), ParameterSpace.of(parameters(load_rig("arm")))
    table = pose_table("arm", poses=6, seed=2)
    observed = Observations(table.counts, table.sigma)
    truth = true_parameters(load_rig("arm"), 2)
    start = assemble(model, observed, truth)
    found = settle(model, observed, start, truth, space.expansion, tolerance=1e-10)

    def coordinates(at: Array) -> Array:
        return settle(
            model,
            observed,
            found.coordinates,
            space.expand(at, truth),
            space.expansion,
            tolerance=1e-10,
        ).coordinates

    slope = _differences(coordinates, space.reduce(truth), np.full(len(space.names), 1e-6))
    # Near the truth residuals are small, and so is the curvature left out.
    np.testing.assert_allclose(found.following, slope, rtol=1e-2, atol=2e-3)


def _compare(
    closure: Callable[[Array, Array], Closure], z: Array, counts: Array, tolerance: float
) -> None:
    at = closure(z, counts)
    slope = _differences(lambda x: closure(x, counts).residual, z, np.full(len(z), 1e-7))
    np.testing.assert_allclose(
        at.by_parameters, slope, rtol=1e-5, atol=tolerance * np.abs(slope).max()
    )
    for c in range(counts.shape[1]):
        moved = np.zeros(counts.shape[1])
        moved[c] = 1.0
        difference = (closure(z, counts + moved).residual - closure(z, counts - moved).residual) / 2
        np.testing.assert_allclose(
            at.by_readings[:, :, c],
            difference,
            rtol=1e-3,
            atol=tolerance * np.abs(difference).max(),
        )


def test_hinge_residual_derivatives() -> None:
    model, space = model_of(load_rig("arm")), ParameterSpace.of(parameters(load_rig("arm")))
    assert isinstance(model, SerialModel)
    counts = pose_table("arm", poses=6, seed=3).counts

    def closure(z: Array, readings: Array) -> Closure:
        return hinge.residual(model, readings, space.expand(z), space.expansion).closure

    _compare(closure, space.reduce(space.nominal), counts, 1e-5)


def test_multi_loop_residual_derivatives() -> None:
    rig = load_rig("shoulder")
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    assert isinstance(model, PlatformModel)
    table = pose_table("shoulder", poses=6, seed=3)
    coordinates = assemble(model, Observations(table.counts, table.sigma), space.nominal)
    rotation, _ = model.plate_pose(coordinates)
    points = np.stack([space.nominal[model.plate[c]] for c in (0, 2)])
    near = points @ np.swapaxes(rotation, 1, 2)

    def closure(z: Array, readings: Array) -> Closure:
        return multi_loop.residual(model, readings, space.expand(z), space.expansion, near)[0]

    assert multi_loop.residual(model, table.counts, space.nominal, space.expansion, near)[1].all()
    _compare(closure, space.reduce(space.nominal), table.counts, 1e-5)
