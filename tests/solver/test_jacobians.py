"""Every analytic derivative of both models against finite differences, at seeded configurations."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import load_rig, parameters
from solver.mechanism.model import model_of
from solver.mechanism.rotation import exponential, left_jacobian, log_rate, logarithm


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_derivatives_match_finite_differences(name: str) -> None:
    rig = load_rig(name)
    rng = np.random.default_rng(3)
    model = model_of(rig)
    x = np.array([p.nominal for p in parameters(rig)]) * (
        1 + 0.01 * rng.standard_normal(len(parameters(rig)))
    )
    u = 0.4 * rng.standard_normal((5, len(model.coordinate_names)))
    at = model.linearise(u, x, np.eye(len(x)))
    for analytic_readings, analytic_closure, vary in (
        (at.readings_by_coordinates, at.closure_by_coordinates, "u"),
        (at.readings_by_parameters, at.closure_by_parameters, "x"),
    ):
        for j in range(analytic_readings.shape[2]):
            size = u[0, j] if vary == "u" else x[j]
            step = 1e-6 * max(
                abs(size), 1e-3 if "gain" not in parameters(rig)[j].name else abs(size)
            )
            sides = []
            for sign in (1, -1):
                moved_u, moved_x = u.copy(), x.copy()
                if vary == "u":
                    moved_u[:, j] += sign * step
                else:
                    moved_x[j] += sign * step
                sides.append(model.linearise(moved_u, moved_x, np.eye(len(x))))
            slope = (sides[0].readings - sides[1].readings) / (2 * step)
            np.testing.assert_allclose(
                analytic_readings[:, :, j], slope, rtol=1e-5, atol=1e-4 * np.abs(slope).max()
            )
            slope = (sides[0].closure - sides[1].closure) / (2 * step)
            np.testing.assert_allclose(analytic_closure[:, :, j], slope, rtol=1e-5, atol=1e-6)


def test_rotation_logarithm_inverts_exponential() -> None:
    rng = np.random.default_rng(0)
    axis = rng.standard_normal((400, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    for angle in (0.0, 1e-9, 1e-5, 1e-3, 1.0, 3.0, np.pi - 1e-7):
        vector = axis * angle
        np.testing.assert_allclose(
            logarithm(exponential(vector)), vector, atol=1e-7 if angle > 3 else 1e-12
        )
        identity = log_rate(vector) @ left_jacobian(vector)
        np.testing.assert_allclose(identity, np.tile(np.eye(3), (400, 1, 1)), atol=1e-6)
