"""The trust region on hard problems of the literature, beside scipy's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from solver.estimate.trust_region import Evaluation, Status, minimise

Array = NDArray[np.float64]
Problem = Callable[[Array], tuple[Array, Array]]


def rosenbrock(z: Array) -> tuple[Array, Array]:
    x, y = z
    return np.array([10 * (y - x**2), 1 - x]), np.array([[-20 * x, 10.0], [-1.0, 0.0]])


def powell_singular(z: Array) -> tuple[Array, Array]:
    """Moré, Garbow & Hillstrom, problem 13: the Jacobian is singular at the solution."""
    a, b, c, d = z
    five, ten = np.sqrt(5.0), np.sqrt(10.0)
    residual = np.array([a + 10 * b, five * (c - d), (b - 2 * c) ** 2, ten * (a - d) ** 2])
    jacobian = np.array(
        [
            [1.0, 10.0, 0.0, 0.0],
            [0.0, 0.0, five, -five],
            [0.0, 2 * (b - 2 * c), -4 * (b - 2 * c), 0.0],
            [2 * ten * (a - d), 0.0, 0.0, -2 * ten * (a - d)],
        ]
    )
    return residual, jacobian


def powell_badly_scaled(z: Array) -> tuple[Array, Array]:
    """Moré, Garbow & Hillstrom, problem 3."""
    x, y = z
    residual = np.array([1e4 * x * y - 1, np.exp(-x) + np.exp(-y) - 1.0001])
    return residual, np.array([[1e4 * y, 1e4 * x], [-np.exp(-x), -np.exp(-y)]])


def freudenstein_roth(z: Array) -> tuple[Array, Array]:
    """Problem 2: a local minimum of 48.98 beside the solution."""
    x, y = z
    residual = np.array([-13 + x + ((5 - y) * y - 2) * y, -29 + x + ((y + 1) * y - 14) * y])
    return residual, np.array([[1, 10 * y - 3 * y**2 - 2], [1, 3 * y**2 + 2 * y - 14]])


def _ours(problem: Problem, start: Array, iterations: int = 300) -> tuple[float, Status]:
    found = minimise(
        lambda z, state: Evaluation(*problem(z), None), start, iterations=iterations, floor=1e-20
    )
    assert found is not None
    return float(found.last.residual @ found.last.residual), found.status


@pytest.mark.parametrize(
    ("problem", "start"),
    [
        (rosenbrock, [-1.2, 1.0]),
        (rosenbrock, [-120.0, 100.0]),
        (powell_singular, [3.0, -1.0, 0.0, 1.0]),
        (powell_badly_scaled, [0.0, 1.0]),
        (freudenstein_roth, [0.5, -2.0]),
    ],
)
def test_reaches_what_scipy_reaches(problem: Problem, start: list[float]) -> None:
    theirs = least_squares(
        lambda z: problem(z)[0],
        start,
        jac=lambda z: problem(z)[1],
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=2000,
    )
    cost, status = _ours(problem, np.array(start))
    assert status is Status.CONVERGED
    assert cost <= 2 * theirs.cost * (1 + 1e-6) + 1e-9


def test_units_of_the_variables_do_not_matter() -> None:
    scale = np.array([1e3, 1e-3])

    def scaled(z: Array) -> tuple[Array, Array]:
        residual, jacobian = rosenbrock(z / scale)
        return residual, jacobian / scale

    steps = [
        minimise(lambda z, state: Evaluation(*rosenbrock(z), None), np.array([-1.2, 1.0])),
        minimise(lambda z, state: Evaluation(*scaled(z), None), np.array([-1.2, 1.0]) * scale),
    ]
    assert steps[0] is not None
    assert steps[1] is not None
    assert steps[0].iterations == steps[1].iterations
    np.testing.assert_allclose(steps[0].variables, steps[1].variables / scale, rtol=1e-9)


def test_a_direction_without_information_is_left_alone() -> None:
    found = minimise(
        lambda z, state: Evaluation(z[:1] - 3.0, np.array([[1.0, 0.0]]), None), np.array([0.0, 7.0])
    )
    assert found is not None
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.variables, [3.0, 7.0], atol=1e-9)


def test_places_that_cannot_be_evaluated_are_not_entered() -> None:
    def walled(z: Array, state: None) -> Evaluation[None] | None:
        return None if z[0] > 2.0 else Evaluation(z - 1.9, np.array([[1.0]]), None)

    start = minimise(walled, np.array([5.0]))
    assert start is None
    found = minimise(walled, np.array([-4.0]))
    assert found is not None
    np.testing.assert_allclose(found.variables, [1.9], atol=1e-8)


def test_the_iteration_limit_is_told() -> None:
    assert _ours(rosenbrock, np.array([-1.2, 1.0]), iterations=2)[1] is Status.ITERATION_LIMIT
