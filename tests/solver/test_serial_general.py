"""Serial mechanisms of every kind: nature poses them, the solver recovers what nature drew.

Nature's kinematics (quaternions) and the solver's (screws) share no code, so that a chain on
which both agree is described as the format says.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from recordings.rig import Rig, SerialMechanism, parameters, parse_rig
from sim_devices.plant.chain import chain_geometry
from sim_devices.plant.loop import Loop
from sim_devices.truth import draw_truth
from solver.dwells import Window
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import model_of
from solver.samples import PoseTable
from solver.solve import Solution, solve_table

Array = NDArray[np.float64]

HOMES = (0.2, 0.4, -0.3, -1.2, 0.3, 1.1, 0.4)
NOISE = 20.0  # counts of 1e-6 rad or m


def sure(value: float, width: float) -> str:
    return f"{{ nominal = {value}, uncertainty = {width}, identify = true }}"


LINKS = (
    "convention = 'urdf'\nz_m = 0.33",
    f"convention = 'urdf'\nrx_deg = -90\nry_deg = {sure(0, 0.5)}\naxis = [0.0, 0.6, 0.8]",
    f"convention = 'urdf'\ny_m = {sure(-0.32, 0.002)}\nrx_deg = 90\naxis = 'y'",
    f"convention = 'hayati'\na_m = {sure(0.08, 0.002)}\nalpha_deg = 80\nbeta_deg = {sure(0, 0.5)}",
    f"theta_offset_deg = {sure(0, 0.5)}\ns_m = 0.38\nalpha_deg = -90",
    f"theta_offset_deg = {sure(0, 0.5)}\na_m = 0.09\nalpha_deg = 90",
    "convention = 'urdf'\naxis = 'x'\nz_m = 0.05",
)


def arm(closure: str, places: tuple[Array, ...], sought: str = "x y z", *, sensed: int = 7) -> Rig:
    """A seven-joint arm with a tip, held in fixtures near ``places`` (x, y, z, rx, ry, rz)."""
    lines = ["schema = 1", "name = 'seven'", "[mechanism]", "family = 'serial'"]
    lines += [f"closure = {{ {closure} }}", "[mechanism.tip]", "x_m = 0.03", "ry_deg = 20"]
    lines.append(f"z_m = {sure(0.1, 0.002)}")
    for number, (home, link) in enumerate(zip(HOMES, LINKS, strict=True), 1):
        lines += ["[[mechanism.joint]]", f"name = 'joint{number}'", f"home_rad = {home}", link]
    for number, place in enumerate(places):
        lines += ["[[mechanism.fixture]]", f"name = 'hole_{number}'"]
        for part, value in zip(("x", "y", "z", "rx", "ry", "rz"), place, strict=True):
            unit = "rad" if "r" in part else "m"
            free = f"{{ nominal = {value}, identify = true }}"
            lines.append(f"{part}_{unit} = {free if part in sought.split() else value}")
    if len(places) > 1:
        apart = float(np.linalg.norm(places[1][:3] - places[0][:3]))
        lines += ["[[mechanism.distance]]", "between = ['hole_0', 'hole_1']"]
        lines.append(f"distance_m = {{ nominal = {apart}, uncertainty = 1e-5 }}")
    for number in range(1, sensed + 1):
        lines += ["[[channel]]", f"name = 'q{number}'", f"senses = 'joint{number}'"]
        lines += ["gain_rad_per_count = 1e-6", f"noise_counts = {NOISE}"]
    return parse_rig("\n".join(lines))


def at_home(turned: Array) -> Array:
    """Where the tip is at the homes, as a fixture (x, y, z, rx, ry, rz); ``turned`` is (rx, ry, rz)."""
    rig = arm('constraint = "ball"', (np.zeros(6),))
    model = model_of(rig)
    nominal = np.array([p.nominal for p in parameters(rig)])
    end = model.end_pose(np.array([HOMES]), nominal, np.zeros((len(nominal), 0)))
    return np.concatenate([end.position[0], turned])


def walked(loop: Loop, home: Array, poses: int, rng: np.random.Generator) -> Array:
    """(poses, J) closed configurations that a random walk from home passes."""
    free = np.zeros(len(home), dtype=bool)
    now = np.zeros(1)
    start, left = loop.polish(home[None], free, now)
    assert left[0] < 1e-10
    out = [start[0]]
    while len(out) < poses:
        before = out[rng.integers(len(out))]
        _, rate = loop.closure(before[None], now)
        _, size, right = np.linalg.svd(rate[0])
        along = right[int((size > 1e-8).sum()) :]
        moved, left = loop.polish(
            (before + 0.4 * along.T @ rng.standard_normal(len(along)))[None], free, now
        )
        if left[0] < 1e-10 and np.abs(moved[0] - start[0]).max() < 1.0:
            out.append(moved[0])
    return np.array(out)


def solved(rig: Rig, seed: int, poses: int) -> tuple[Solution, Array]:
    """The solution of ``poses`` simulated poses a fixture, and the true parameters (N,)."""
    mechanism = rig.mechanism
    assert isinstance(mechanism, SerialMechanism)
    truth = draw_truth(rig, seed)
    rng = np.random.default_rng(seed)
    home = np.array([joint.home.nominal for joint in mechanism.joints])
    channels = [mechanism.places.index(c.senses) for c in rig.channels]
    readings, windows = [], []
    for fixture in mechanism.fixture_names or (None,):
        loop = Loop(mechanism, chain_geometry(mechanism, truth.parameters, fixture))
        variables = walked(loop, home, poses, rng)[:, channels]
        for row in variables:
            windows.append(Window(len(windows), len(windows), len(windows), 0, fixture))
            values = [
                (v - truth.parameters[f"{c.name}.offset"]) / truth.parameters[f"{c.name}.gain"]
                for c, v in zip(rig.channels, row, strict=True)
            ]
            readings.append(values)
    noise = np.array([channel.noise for channel in rig.channels])
    counts = np.array(readings) + noise * rng.standard_normal((len(readings), len(noise)))
    table = PoseTable(
        tuple(c.name for c in rig.channels),
        counts,
        np.tile(noise, (len(counts), 1)),
        np.ones(counts.shape, dtype=np.int64),
        np.ones(counts.shape),
        noise,
        np.ones(len(noise)),
        tuple(windows),
        (),
    )
    solution = solve_table(rig, table, poses=len(counts))
    return solution, np.array([truth.parameters[p.name] for p in parameters(rig)])


def check(solution: Solution, truth: Array) -> None:
    """The data are explained, and the truth lies within the errors that are promised."""
    estimate = solution.estimate
    space = estimate.space
    assert 0.6 < estimate.misfit < 1.6
    errors = (estimate.values - space.reduce(truth)) / estimate.standard_errors
    known = np.isfinite(space.uncertainty)
    assert np.sqrt(np.mean(errors[known] ** 2)) < 1.8
    assert np.abs(errors[known]).max() < 4.0
    better = estimate.standard_errors[known] < 0.5 * space.uncertainty[known]
    assert better.sum() >= known.sum() // 2


@pytest.mark.parametrize(
    ("closure", "sought", "turned"),
    [
        ('constraint = "ball"', "x y z", False),
        ('constraint = "plane"', "z rx ry", True),
        ('constraint = "slider"', "x y rx ry rz", True),
        ('constraint = "hinge"', "x y z rx ry", True),
        ('constraint = "rigid"', "x y z rx ry rz", True),
        ('constraint = "custom", free = ["x", "y", "rx", "ry", "rz"]', "z rx ry", True),
    ],
)
def test_every_constraint_recovers_the_truth(closure: str, sought: str, turned: bool) -> None:
    place = at_home(tip_turns() if turned else np.zeros(3))
    solution, truth = solved(arm(closure, (place,), sought), seed=3, poses=40)
    check(solution, truth)


def tip_turns() -> Array:
    """rx, ry, rz of the tip at the homes."""
    rig = arm('constraint = "ball"', (np.zeros(6),))
    model = model_of(rig)
    nominal = np.array([p.nominal for p in parameters(rig)])
    turn = model.end_pose(np.array([HOMES]), nominal, np.zeros((len(nominal), 0))).rotation[0]
    level = np.hypot(turn[0, 0], turn[1, 0])
    return np.array(
        [
            np.arctan2(turn[2, 1], turn[2, 2]),
            np.arctan2(-turn[2, 0], level),
            np.arctan2(turn[1, 0], turn[0, 0]),
        ]
    )


def test_two_sockets_in_one_solve() -> None:
    place = at_home(np.zeros(3))
    other = place + np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    solution, truth = solved(arm('constraint = "ball"', (place, other)), seed=5, poses=30)
    check(solution, truth)


def test_derivatives_of_every_convention_match_finite_differences() -> None:
    place = at_home(tip_turns())
    rig = arm('constraint = "hinge"', (place, place + 0.01), "x y z rx ry")
    model, rng = model_of(rig), np.random.default_rng(1)
    x = np.array([p.nominal for p in parameters(rig)])
    x = x + 0.02 * rng.standard_normal(len(x)) * (x != 1e-6)
    u = np.array([[*HOMES, 0.1]]) + 0.1 * rng.standard_normal((4, 8))
    fixture = Circumstances(fixture=np.array([0, 1, 1, 0]))
    at = model.linearise(u, x, np.eye(len(x)), fixture)
    for j in range(u.shape[1]):
        step = np.zeros(u.shape[1])
        step[j] = 1e-6
        ahead, behind = (model.linearise(u + s * step, x, np.eye(len(x)), fixture) for s in (1, -1))
        slope = (ahead.closure - behind.closure) / 2e-6
        np.testing.assert_allclose(at.closure_by_coordinates[:, :, j], slope, atol=1e-7)
    for j, parameter in enumerate(parameters(rig)):
        if parameter.name.endswith("gain"):
            continue
        step = np.zeros(len(x))
        step[j] = 1e-6
        ahead, behind = (model.linearise(u, x + s * step, np.eye(len(x)), fixture) for s in (1, -1))
        slope = (ahead.closure - behind.closure) / 2e-6
        np.testing.assert_allclose(at.closure_by_parameters[:, :, j], slope, atol=1e-7)
    known, rates = model.pseudo_observations(x, np.eye(len(x)))
    moved = model.pseudo_observations(x + 1e-7 * np.ones(len(x)), np.eye(len(x)))[0]
    np.testing.assert_allclose(rates @ np.ones(len(x)), (moved - known) / 1e-7, atol=1e-2)
