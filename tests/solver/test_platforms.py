"""Platforms in general: derivatives, nature's own kinematics, branches, and what calibrations recover."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.averaged_nature import averaged_nature
from benchmarks.hangprinter import recorded, solved
from recordings.rig import Rig, load_rig, parameters, parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.quaternion import about, product
from sim_devices.plant.session import legs_and_markers
from solver.estimate import likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.identifiability import identifiability
from solver.estimate.nuisance import Observations, assemble, settle
from solver.estimate.trust_region import Status
from solver.mechanism.model import Model, model_of
from solver.mechanism.rotation import exponential
from solver.mechanism.space import ParameterSpace
from solver.samples import average

Array = NDArray[np.float64]

RIGS = ("shoulder-all", "stewart", "hangprinter")


def solve_seed(rig: Rig, seed: int, poses: int, samples: int = 15) -> tuple[Estimate, Array, float]:
    """Estimate from nominal values, truth, and the likelihood ratio between the two."""
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed = averaged_nature(rig, seed, poses, samples)
    estimate = likelihood.identify(model, space, observed)
    at_truth = settle(model, observed, estimate.coordinates, truth, space.expansion)
    return estimate, truth, at_truth.cost - float(estimate.residual @ estimate.residual)


def pulls(estimate: Estimate, truth: Array) -> Array:
    return (estimate.values - estimate.space.reduce(truth)) / estimate.standard_errors


@pytest.mark.parametrize("name", RIGS)
def test_derivatives_match_finite_differences(name: str) -> None:
    rig = load_rig(name)
    model, table = model_of(rig), parameters(rig)
    rng = np.random.default_rng(3)
    x = np.array([p.nominal for p in table]) * (1 + 0.01 * rng.standard_normal(len(table)))
    size = len(model.coordinate_names)
    u = 0.2 * rng.standard_normal((5, size))
    at = model.linearise(u, x, np.eye(len(x)))
    for j in range(size):
        step = np.zeros(size)
        step[j] = 1e-6
        ends = [model.linearise(u + s * step, x, np.eye(len(x))).readings for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(
            at.readings_by_coordinates[:, :, j], slope, atol=1e-6 * np.abs(slope).max()
        )
    for j, parameter in enumerate(table):
        size_x = abs(x[j]) if "gain" in parameter.name else max(abs(x[j]), 1e-3)
        step = np.zeros(len(x))
        step[j] = 1e-5 * size_x
        ends = [model.linearise(u, x + s * step, np.eye(len(x))).readings for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step[j])
        np.testing.assert_allclose(
            at.readings_by_parameters[:, :, j], slope, atol=1e-6 * np.abs(slope).max() + 1e-9
        )


@pytest.mark.parametrize("name", [*RIGS, "shoulder"])
def test_the_model_reads_what_nature_reads(name: str) -> None:
    """Two kinematics that share no code, at the same plate poses."""
    rig = load_rig(name)
    model, nature = model_of(rig), make_nature(rig, 4)
    plate = nature.mechanism
    x = np.array([nature.truth.parameters[p.name] for p in parameters(rig)])
    rng = np.random.default_rng(1)
    turned, shifted = 0.4 * rng.standard_normal((2, 20, 3))
    angle = np.linalg.norm(turned, axis=1)
    q = product(about(turned / angle[:, None], angle), plate.neutral_turn)
    if not plate.turns:
        q = np.broadcast_to(plate.neutral_turn, q.shape)
    shift = plate.neutral_shift + shifted * plate.shifts
    u = np.hstack([turned] * plate.turns + [shifted] * plate.shifts)
    value = nature.by_channel(legs_and_markers(nature, plate, q, shift, np.zeros(20)))
    readings = model.linearise(u, x, np.zeros((len(x), 0))).readings
    for k, channel in enumerate(rig.channels):
        gain, offset = (
            x[[p.name for p in parameters(rig)].index(f"{channel.name}.{part}")]
            for part in ("gain", "offset")
        )
        np.testing.assert_allclose(
            gain * (readings[:, k] - channel.zero_count) + offset, value[channel.name], atol=1e-12
        )


def test_a_stewart_platform_with_a_redundant_leg_recovers_the_truth() -> None:
    rig = load_rig("stewart")
    estimate, truth, ratio = solve_seed(rig, 3, 120)
    assert estimate.status is Status.CONVERGED
    assert estimate.held.shape[1] == 0
    assert abs(estimate.misfit - 1) < 5 * np.sqrt(2 / estimate.freedoms)
    assert ratio < chi2.ppf(0.9999, len(estimate.values))
    assert np.abs(pulls(estimate, truth)).max() < 4.5
    start = np.abs(estimate.space.reduce(estimate.space.nominal - truth))
    assert np.median(estimate.standard_errors) < 0.3 * np.median(start)


def test_a_cable_machine_recovers_its_anchors_from_changes_of_length() -> None:
    estimate, truth, ratio = solve_seed(load_rig("hangprinter"), 5, 60)
    assert estimate.status is Status.CONVERGED
    assert ratio < chi2.ppf(0.9999, len(estimate.values))
    assert np.abs(pulls(estimate, truth)).max() < 4.5


def test_frames_that_are_not_fixed_are_named() -> None:
    """All base coordinates of the cable machine free: it may turn as a whole, and says so."""
    text = rig_text("hangprinter")[0].replace(
        "x_mm = 0\ny_mm = {", "x_mm = { nominal = 0, uncertainty = 50, identify = true }\ny_mm = {"
    )
    rig = parse_rig(text)
    space = ParameterSpace.of(parameters(rig))
    assert "A.x" in space.names
    _, observed = averaged_nature(rig, 5, 60, 15)
    estimate = likelihood.identify(model_of(rig), space, observed)
    assert estimate.status is Status.CONVERGED
    found = identifiability(space, estimate.jacobian, estimate.parameters)
    assert found.rank == len(space.names) - 1


@pytest.mark.parametrize("seed", range(5))
def test_all_parameters_of_the_shoulder_converge_from_two_percent(seed: int) -> None:
    rig = load_rig("shoulder-all")
    estimate, _, ratio = solve_seed(rig, seed, 100)
    found = identifiability(estimate.space, estimate.jacobian, estimate.parameters)
    assert estimate.status is Status.CONVERGED
    assert chi2.ppf(0.0001, estimate.freedoms) < estimate.misfit * estimate.freedoms
    assert estimate.misfit * estimate.freedoms < chi2.ppf(0.9999, estimate.freedoms)
    assert found.rank == 18
    assert ratio < chi2.ppf(0.9999, found.rank)
    # The gauges: a scale of all lengths and gains, made of one for each pair of legs.
    assert "the common scale of all lengths and gains" in found.combinations
    names = estimate.space.names
    left = [n[:2] in ("A1", "A2", "B1", "d1", "d2") for n in names]
    for mine in (np.array(left), ~np.array(left)):
        change = np.where(mine, estimate.values, 0.0)
        assert np.linalg.norm(estimate.jacobian @ change) < 1e-6 * np.linalg.norm(
            estimate.jacobian * change
        )


class StartsAstray:
    """A model whose starts are useless for some poses."""

    def __init__(self, model: Model, astray: NDArray[np.intp], far: Array) -> None:
        self._model, self._astray, self._far = model, astray, far

    def __getattr__(self, name: str) -> object:
        return getattr(self._model, name)

    def starts(self, readings: Array, parameters: Array) -> Array:
        start = self._model.starts(readings, parameters)[:1].copy()
        if len(readings) > self._astray.max():
            start[0, self._astray] = self._far
        return start


def test_poses_that_settle_badly_take_over_the_assembly_of_their_neighbours() -> None:
    rig = load_rig("shoulder")
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed = averaged_nature(rig, 2, 60, 15)
    right = assemble(model, observed, truth)
    far = np.array([3.0, 0.5, 0.0])
    alone = settle(model, observed, np.tile(far, (60, 1)), truth, space.expansion)
    astray = np.flatnonzero(np.sum(alone.residual**2, axis=1) > 1e4)[:8]
    assert len(astray) > 0
    found = assemble(StartsAstray(model, astray, far), observed, truth)
    np.testing.assert_allclose(found, right, atol=1e-4)


def test_starts_stay_on_the_branch_of_the_neutral_pose() -> None:
    """At nominal, wrong by 1 mm everywhere, every pose of the Stewart platform settles where it is."""
    rig = load_rig("stewart")
    model = model_of(rig)
    truth, observed = averaged_nature(rig, 3, 150, 15)
    nominal = ParameterSpace.of(parameters(rig)).nominal
    apart = exponential(assemble(model, observed, nominal)[:, :3]).swapaxes(1, 2) @ exponential(
        assemble(model, observed, truth)[:, :3]
    )
    assert np.arccos((np.trace(apart, axis1=1, axis2=2) - 1) / 2).max() < np.deg2rad(6)


def test_the_measured_cable_machine(tmp_path) -> None:
    recording = recorded(tmp_path / "hangprinter.mcap")
    table = average(recording)
    assert table.counts.shape == (11, 4)
    np.testing.assert_allclose(table.sigma, np.hypot(100, np.sqrt(1 / 12)), rtol=1e-3)
    observed = Observations(table.counts, table.sigma)
    distinct = observed.take(np.unique(table.counts, axis=0, return_index=True)[1])
    alone, held = (solved(load_rig("hangprinter"), distinct, prior) for prior in (None, 50.0))
    hand = alone.space.reduce(alone.space.nominal)
    assert alone.status is held.status is Status.CONVERGED
    assert alone.freedoms == 1
    # What the lines say agrees with the hand, which is good to some centimetres.
    for estimate in (alone, held):
        wide = np.hypot(estimate.standard_errors, 0.05)
        assert np.all(np.abs(estimate.values - hand) < 2.5 * wide)
    assert np.all(held.standard_errors < np.minimum(alone.standard_errors, 0.05))
