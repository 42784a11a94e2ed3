"""What can be identified: rank against noise, null directions in words, and what holds them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from recordings.rig import Rig, load_rig, parameters
from solver.estimate import likelihood
from solver.estimate.identifiability import (
    BY_NOMINAL,
    BY_PRIORS,
    Identifiability,
    at_priors,
    covariance,
    free_directions,
    identifiability,
)
from solver.estimate.nuisance import Observations, settle
from solver.estimate.null_directions import point_frames
from solver.estimate.trust_region import Status
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import wander

Array = NDArray[np.float64]


def generic(rig: Rig, names: list[str], poses: int = 60) -> tuple[ParameterSpace, Array]:
    """Space of ``names``, and the whitened Jacobian (M, n) of generic poses at nominal."""
    model, space = model_of(rig), ParameterSpace.of(parameters(rig), names)
    u = wander(rig, model, space.nominal, poses, seed=1)
    at = model.linearise(u, space.nominal, space.expansion)
    sigma = np.tile([channel.noise for channel in rig.channels], (poses, 1))
    settled = settle(model, Observations(at.readings, sigma), u, space.nominal, space.expansion)
    return space, settled.jacobian.reshape(-1, len(names))


def named(rig: Rig, names: list[str]) -> Identifiability:
    space, jacobian = generic(rig, names)
    return identifiability(space, jacobian, space.nominal, point_frames(rig))


def own(rig: Rig) -> list[str]:
    return [p.name for p in parameters(rig) if p.identify]


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_bundled_rigs_are_identifiable(name: str) -> None:
    rig = load_rig(name)
    found = named(rig, own(rig))
    assert found.rank == len(own(rig))
    assert found.combinations == ()


def test_sensor_and_joint_offsets_are_seen_as_their_sum() -> None:
    rig = load_rig("arm")
    found = named(rig, [*own(rig), "q3.offset", "q6.offset"])
    assert set(found.combinations) == {
        "joint3.theta_offset and q3.offset, seen only as their sum",
        "joint6.theta_offset and q6.offset, seen only as their sum",
    }
    assert found.rank == 14


def test_both_upper_links_of_the_arm_add_one_parameter() -> None:
    rig = load_rig("arm")
    for added, rank in (("joint3.s", 15), ("joint5.s", 15)):
        assert named(rig, [*own(rig), added]).rank == rank
    both = named(rig, [*own(rig), "joint3.s", "joint5.s"])
    assert both.rank == 15
    assert both.combinations == ("the common scale of all lengths",)


def test_collinear_links_are_seen_as_their_sum() -> None:
    rig = load_rig("arm")
    space, jacobian = generic(rig, [*own(rig), "joint3.s", "joint5.s"])
    names = list(space.names)
    jacobian[:, names.index("joint5.s")] = jacobian[:, names.index("joint3.s")]
    assert identifiability(space, jacobian).combinations == (
        "joint3.s and joint5.s, seen only as their sum",
    )


def test_common_scale_of_the_shoulder() -> None:
    rig = load_rig("shoulder")
    lengths = ["A1.x", "A2.x", "A2.y"] + [
        f"d{i}.{part}" for i in range(1, 5) for part in ("offset", "gain")
    ]
    assert named(rig, lengths).rank == 11
    with_plate = named(rig, [*lengths, "B1.z", "B2.z"])
    assert with_plate.rank == 13
    free = [p.name for p in parameters(rig) if p.tie is None and (p.nominal or p.name[0] == "d")]
    found = named(rig, free)
    assert "the common scale of all lengths and gains" in found.combinations


def test_everything_free_on_the_shoulder_is_readable() -> None:
    rig = load_rig("shoulder")
    found = named(rig, [p.name for p in parameters(rig) if p.tie is None])
    assert len(found.combinations) == found.held.shape[1] == 7
    assert {"A1.z and A4.z, seen only as their sum", "a turn of all base points about z"} < set(
        found.combinations
    )


def test_readable_directions_span_what_is_held() -> None:
    rig = load_rig("shoulder")
    found = named(rig, [p.name for p in parameters(rig) if p.tie is None])
    basis = np.column_stack([d.change / found.plausible for d in found.directions])
    basis /= np.linalg.norm(basis, axis=0)
    assert np.abs(basis - found.held @ (found.held.T @ basis)).max() < 0.05
    assert np.linalg.matrix_rank(basis, tol=1e-3) == found.held.shape[1]


def test_rank_follows_the_noise() -> None:
    rig = load_rig("shoulder")
    space, jacobian = generic(rig, own(rig))
    assert identifiability(space, jacobian).rank == 7
    # Sensors worse by a factor leave fewer directions, and sensors too bad leave none.
    ranks = [identifiability(space, jacobian / worse).rank for worse in (1, 30, 300, 3000, 1e6)]
    assert ranks == sorted(ranks, reverse=True)
    assert ranks[-1] == 0
    # Units and scale of the residual are all that matter: no fixed threshold on their ratio.
    assert identifiability(space, jacobian * 1e3).rank == 7


def test_one_that_no_pose_shows() -> None:
    rig = load_rig("arm")
    found = named(rig, [*own(rig), "hinge.theta_offset"])
    assert found.combinations == ("hinge.theta_offset, which no pose shows",)
    assert found.directions[0].members == ("hinge.theta_offset",)


def test_free_directions_leave_held_ones_at_their_priors() -> None:
    rng = np.random.default_rng(0)
    held, width = rng.standard_normal((5, 2)), rng.uniform(0.5, 2.0, 5)
    free = free_directions(held, width)
    assert free.shape == (5, 3)
    assert np.abs(held.T @ (free / width[:, None] ** 2)).max() < 1e-12
    nominal, values = rng.standard_normal(5), rng.standard_normal(5)
    moved = at_priors(values, nominal, held, width)
    assert np.abs((held / width[:, None] ** 2).T @ (moved - nominal)).max() < 1e-12
    assert np.linalg.matrix_rank(np.column_stack([held, moved - values]), tol=1e-9) == 2


def readings(rig: Rig, space: ParameterSpace, truth: Array, seed: int) -> Observations:
    model, rng = model_of(rig), np.random.default_rng(seed)
    u = wander(rig, model, truth, 40, seed=2)
    counts = model.linearise(u, truth, space.expansion).readings
    sigma = np.tile([channel.noise for channel in rig.channels], (40, 1))
    return Observations(counts + sigma * rng.standard_normal(counts.shape), sigma)


def test_the_scale_stays_nominal_and_all_else_is_found() -> None:
    rig = load_rig("arm")
    space = ParameterSpace.of(parameters(rig), [*own(rig), "joint3.s", "joint5.s"])
    rng = np.random.default_rng(4)
    moved = np.where(np.isfinite(space.uncertainty), space.uncertainty, 0.003)
    truth = space.expand(space.reduce(space.nominal) + 0.3 * moved * rng.standard_normal(16))
    got = likelihood.identify(model_of(rig), space, readings(rig, space, truth, 5))
    assert got.status is Status.CONVERGED
    assert got.held.shape == (16, 1)
    lengths = np.array([space.table[i].dimension == "length" for i in space.identified])
    # A gauge: scaled onto the estimate, the truth lies within the standard errors.
    scale = (got.values[lengths] @ space.reduce(truth)[lengths]) / np.sum(
        space.reduce(truth)[lengths] ** 2
    )
    expected = space.reduce(truth) * np.where(lengths, scale, 1.0)
    ratios = (got.values - expected) / got.standard_errors
    assert np.abs(ratios).max() < 4.5
    assert np.isfinite(got.standard_errors).all()


def test_stated_uncertainties_hold_and_are_counted() -> None:
    rig = load_rig("arm")
    table = tuple(
        replace(p, uncertainty=np.deg2rad(0.5)) if p.name == "q3.offset" else p
        for p in parameters(rig)
    )
    space = ParameterSpace.of(table, [*own(rig), "q3.offset"])
    truth = space.nominal
    shift = np.deg2rad(2.0)
    truth[[p.name for p in table].index("joint3.theta_offset")] += shift
    got = likelihood.identify(model_of(rig), space, readings(rig, space, truth, 1))
    joint, sensor = (space.names.index(n) for n in ("joint3.theta_offset", "q3.offset"))
    change = got.values - space.reduce(space.nominal)
    # Only their sum shows; it is shared by the squares of what each is uncertain by (3 and 0.5 deg).
    assert change[joint] + change[sensor] == pytest.approx(shift, rel=0.02)
    assert change[sensor] / change[joint] == pytest.approx(0.25 / 9.0, rel=0.05)
    width = 3.0 * 0.5 / np.hypot(3.0, 0.5)
    assert np.rad2deg(got.standard_errors[sensor]) == pytest.approx(width, rel=0.02)


def test_held_by_says_which() -> None:
    rig = load_rig("arm")
    space, jacobian = generic(rig, [*own(rig), "q3.offset"])
    cov, found = covariance(space, jacobian)
    assert found.held_by == (BY_NOMINAL,)
    # Held at nominal values, it is taken as exact: the errors of both offsets are one.
    assert np.linalg.matrix_rank(cov / np.outer(found.plausible, found.plausible), tol=1e-16) == 14
    stated = tuple(
        replace(p, uncertainty=0.01) if p.name == "q3.offset" else p for p in space.table
    )
    known = ParameterSpace.of(stated, list(space.names))
    assert covariance(known, jacobian)[1].held_by == (BY_PRIORS,)
