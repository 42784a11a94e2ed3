"""Averaged poses and solutions of the bundled rigs, made from the model itself, for tests of what comes after.

The readings come from the solver's own model, so nothing here tests the model; it gives the
report and its like something true to show.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, load_rig, parameters, visits
from solver.dwells import Window
from solver.estimate.nuisance import Observations, settle
from solver.mechanism.model import Model, model_of
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.samples import PoseTable, Rejected
from solver.solve import Solution, solve_table

Array = NDArray[np.float64]

_SAMPLES = 40
_STEPS = 30  # from home to a target, so that each pose stays on the branch of home


def true_parameters(rig: Rig, seed: int) -> Array:
    """(N,) nominal values, the identified ones moved by their stated uncertainties, SI."""
    space = ParameterSpace.of(parameters(rig))
    draw = np.random.default_rng([seed, 0]).standard_normal(len(space.names))
    return space.expand(space.reduce(space.nominal) + space.uncertainty * draw)


def pose_table(name: str, *, seed: int = 0, poses: int = 60, bend_counts: float = 0.0) -> PoseTable:
    """Averaged dwells of the bundled rig ``name`` at ``true_parameters(rig, seed)``.

    Args:
        name: "arm" or "shoulder".
        seed: of truth, poses and noise.
        poses: how many.
        bend_counts: amplitude of a sinusoidal nonlinearity that no model has, on the last two channels.
    """
    rig = load_rig(name)
    model = model_of(rig)
    truth = true_parameters(rig, seed)
    rng = np.random.default_rng([seed, 1])
    coordinates = _closed(rig, model, truth, poses, rng)
    counts = model.linearise(coordinates, truth, np.zeros((len(truth), 0))).readings
    counts[:, -2:] += bend_counts * np.sin(counts[:, -2:] / 300.0)
    noise = np.array([channel.noise for channel in rig.channels])
    sigma = np.tile(noise / np.sqrt(_SAMPLES), (poses, 1))
    windows = tuple(Window(int(i * 1.5e9), int(i * 1.5e9 + 0.4e9), i, 0) for i in range(poses))
    return PoseTable(
        channels=tuple(channel.name for channel in rig.channels),
        counts=counts + sigma * rng.standard_normal(counts.shape),
        sigma=sigma,
        samples=np.full(counts.shape, _SAMPLES),
        effective=np.full(counts.shape, float(_SAMPLES)),
        noise=noise,
        correlation=np.ones(len(noise)),
        windows=windows,
        rejected=(
            Rejected(
                Window(0, 1, poses, 0),
                f"still moving: {rig.channels[0].name} moved +9.0 counts between the halves of the dwell",
            ),
        ),
    )


def _closed(rig: Rig, model: Model, truth: Array, poses: int, rng: np.random.Generator) -> Array:
    """(P, U) configurations that close at ``truth``."""
    if not isinstance(model, SerialModel):
        return 0.35 * rng.standard_normal((poses, len(model.coordinate_names)))
    assert rig.plan is not None
    targets = np.array([visit.targets for visit in visits(rig.plan, poses)])[:poses]
    drives = [model.coordinate_names.index(name) for name in rig.plan.drives]
    channel = [int(np.flatnonzero(model.sensed == drive)[0]) for drive in drives]
    loose = np.full((poses, len(model.channels)), 1e3)
    loose[:, channel] = 1.0
    nowhere = np.zeros((len(truth), 0))
    at = np.tile(model.homes, (poses, 1))
    for share in np.linspace(0.0, 1.0, _STEPS):
        wanted = at.copy()
        wanted[:, drives] = (1 - share) * model.homes[drives] + share * targets
        readings = model.linearise(wanted, truth, nowhere).readings
        at = settle(model, Observations(readings, loose), wanted, truth, nowhere).coordinates
    return at


@cache
def solution(
    name: str,
    *,
    seed: int = 0,
    poses: int = 60,
    use: int = 50,
    bend_counts: float = 0.0,
    method: str | None = None,
) -> Solution:
    """The bundled rig ``name`` calibrated from `pose_table`; made once for each set of arguments."""
    table = pose_table(name, seed=seed, poses=poses, bend_counts=bend_counts)
    return solve_table(load_rig(name), table, poses=use, method=method)


def truth_shown(name: str, seed: int = 0) -> Mapping[str, float]:
    """`true_parameters` by name, in the units that results show (m, deg, ...)."""
    rig = load_rig(name)
    return {
        p.name: float(value / p.to_si)
        for p, value in zip(parameters(rig), true_parameters(rig, seed), strict=True)
    }
