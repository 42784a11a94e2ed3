"""External trackers: derivatives, nature's own kinematics, cameras anywhere, shoulder and free arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.averaged_nature import averaged_nature
from benchmarks.shoulder_table1 import TRACKER
from recordings.reader import read_recording
from recordings.rig import Rig, load_rig, parameters, parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.loop import Loop
from sim_devices.plant.motion import Course
from sim_devices.simulate import simulate
from solver.estimate import likelihood
from solver.estimate.locating import located
from solver.estimate.nuisance import Observations
from solver.estimate.trust_region import Status
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.solve import solve

Array = NDArray[np.float64]

JOINT = """
[[mechanism.joint]]
name = "joint{k}"
theta_offset_deg = {theta}
s_mm = {s}
a_mm = {a}
alpha_deg = {alpha}

[[channel]]
name = "q{k}"
senses = "joint{k}"
gain_deg_per_count = 0.001
noise_counts = 2
"""


def free(nominal: float, uncertainty: float) -> str:
    return f"{{ nominal = {nominal}, uncertainty = {uncertainty}, identify = true }}"


PLAN = """
[plan]
mode = "driven"
drives = ["joint1", "joint2", "joint3", "joint4"]
corners_deg = [[-60, -60, -60, -60], [60, -60, -60, -60], [-60, 60, -60, -60], [-60, -60, 60, -60], [-60, -60, -60, 60], [60, 60, 60, 60]]
move_deg_per_s = 180
poses = 40
dwell_s = 0.15
settle_s = 0.05
revisit = { poses = 0, visits = 1 }
"""


def free_arm_text(tracker: str) -> str:
    """Four joints in free space before a camera. The first link's frame is the camera's to find."""
    head = 'schema = 1\nname = "free-arm"\n\n[mechanism]\nfamily = "serial"\nclosure = { constraint = "open" }\n'
    links = ((0, 300, 0, 90), (free(20, 1), free(0, 2), free(250, 2), free(0, 0.5)))
    more = (
        (free(-40, 1), free(30, 2), free(60, 2), free(-90, 0.5)),
        (free(10, 1), free(280, 2), free(0, 2), free(90, 0.5)),
    )
    joints = [
        JOINT.format(k=k + 1, theta=theta, s=s, a=a, alpha=alpha)
        for k, (theta, s, a, alpha) in enumerate((*links, *more))
    ]
    return head + "".join(joints) + tracker


def free_arm(tracker: str) -> Rig:
    return parse_rig(free_arm_text(tracker))


def tracker_text() -> str:
    return "\n" + TRACKER.read_text("utf-8")


def shoulder() -> Rig:
    return parse_rig(rig_text("shoulder")[0] + tracker_text())


def posed(rig: Rig, seed: int, poses: int, samples: int = 10) -> tuple[Array, Observations, Array]:
    """Truth (N,), averaged readings and joint variables of an arm in free space, by nature."""
    nature = make_nature(rig, seed)
    assert isinstance(nature.mechanism, Loop)
    rng = np.random.default_rng(seed)
    variables = rng.uniform(-1.2, 1.2, (poses, len(rig.mechanism.places)))
    seen = nature.trackers.seen(*nature.mechanism.end(variables, np.zeros(poses)))
    value = nature.by_channel(np.hstack([variables, seen]))
    columns = []
    for channel in rig.channels:
        many = np.repeat(value[channel.name], samples)
        course = Course(
            np.arange(float(len(many))), {channel.name: many}, {channel.name: 0.0 * many}
        )
        raw = nature.sensors[channel.name].counts(course, rng)
        columns.append(raw.reshape(poses, samples).mean(axis=1))
    noise = np.array([np.hypot(c.noise, np.sqrt(1 / 12)) for c in rig.channels])
    truth = np.array([nature.truth.parameters[p.name] for p in parameters(rig)])
    sigma = np.tile(noise / np.sqrt(samples), (poses, 1))
    return truth, Observations(np.stack(columns, axis=1), sigma), variables


@pytest.mark.parametrize("rig", [shoulder(), free_arm(tracker_text())], ids=lambda rig: rig.name)
def test_derivatives_match_finite_differences(rig: Rig) -> None:
    model, table = model_of(rig), parameters(rig)
    rng = np.random.default_rng(3)
    scatter = np.array([0.0 if "gain" in p.name else 0.02 for p in table])
    x = np.array([p.nominal for p in table]) + scatter * rng.standard_normal(len(table))
    size = len(model.coordinate_names)
    u = 0.4 * rng.standard_normal((4, size))
    at = model.linearise(u, x, np.eye(len(x)))
    for j in range(size):
        step = 1e-6 * np.eye(size)[j]
        ends = [model.linearise(u + s * step, x, np.eye(len(x))) for s in (1, -1)]
        slope = (ends[0].readings - ends[1].readings) / 2e-6
        np.testing.assert_allclose(
            at.readings_by_coordinates[:, :, j], slope, atol=1e-6 * np.abs(slope).max() + 1e-9
        )
    for j in range(len(x)):
        size_x = abs(x[j]) if "gain" in table[j].name else max(abs(x[j]), 1e-2)
        step = 1e-5 * size_x * np.eye(len(x))[j]
        ends = [model.linearise(u, x + s * step, np.eye(len(x))) for s in (1, -1)]
        slope = (ends[0].readings - ends[1].readings) / (2e-5 * size_x)
        np.testing.assert_allclose(
            at.readings_by_parameters[:, :, j], slope, atol=1e-6 * np.abs(slope).max() + 1e-9
        )


@pytest.mark.parametrize("base", [False, True])
def test_an_arm_is_seen_where_nature_sees_it(base: bool) -> None:
    """Also where the arm's base frame lies behind a joint: chains that share no code."""
    rig = free_arm(tracker_text())
    if base:
        moved = rig.mechanism.model_copy(update={"base": "joint1"})
        rig = rig.model_copy(update={"mechanism": moved})
    truth, _, variables = posed(rig, 1, 12)
    nature = make_nature(rig, 1)
    model = model_of(rig)
    ends = np.zeros((12, len(model.coordinate_names)))
    ends[:, : variables.shape[1]] = variables
    readings = model.linearise(ends, truth, np.zeros((len(truth), 0))).readings
    seen = nature.trackers.seen(*nature.mechanism.end(variables, np.zeros(12)))
    marker = [k for k, c in enumerate(rig.channels) if c.senses.startswith("m")]
    assert len(marker) == 9
    np.testing.assert_allclose(readings[:, marker] * 1e-6, seen, atol=1e-12)


def test_the_shoulder_before_a_camera_recovers_everything() -> None:
    rig = shoulder()
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed = averaged_nature(rig, 5, 100, 10)
    estimate = likelihood.identify(model, space, observed)
    assert estimate.status is Status.CONVERGED
    # Camera frame, markers and shoulder are all determined: the legs know the plate's orientation.
    assert len(space.names) == 22
    assert estimate.held.shape[1] == 0
    assert abs(estimate.misfit - 1) < 5 * np.sqrt(2 / estimate.freedoms)
    pulls = (estimate.values - space.reduce(truth)) / estimate.standard_errors
    assert np.abs(pulls).max() < 4.5


def test_a_tracker_tightens_what_the_legs_alone_determine() -> None:
    alone, watched = load_rig("shoulder"), shoulder()
    errors = []
    for rig in (alone, watched):
        _, observed = averaged_nature(rig, 6, 60, 10)
        space = ParameterSpace.of(parameters(rig))
        estimate = likelihood.identify(model_of(rig), space, observed)
        errors.append(dict(zip(space.names, estimate.standard_errors, strict=True)))
    assert all(errors[1][name] < errors[0][name] for name in errors[0])


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_may_stand_anywhere(seed: int) -> None:
    """Its nominal place is metres off and it looks the other way: the start is found, then the answer."""
    rig = shoulder()
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed = averaged_nature(rig, seed, 60, 10)
    names = [p.name for p in parameters(rig)]
    start = space.nominal
    rng = np.random.default_rng(seed)
    for part in ("x", "y", "z", "rx", "ry", "rz"):
        start[names.index(f"camera.{part}")] = 2.0 * rng.standard_normal()
    near = located(model, space, observed, start)
    camera = [names.index(f"camera.{axis}") for axis in "xyz"]
    assert np.abs(near[camera] - truth[camera]).max() < 0.1
    estimate = likelihood.identify(model, space, observed, start=start)
    assert estimate.status is Status.CONVERGED
    gap = estimate.parameters[camera] - truth[camera]
    assert np.abs(gap).max() < 0.005
    # Two rotation vectors a whole turn apart are one orientation: the rest is compared as numbers.
    rest = [k for k, name in enumerate(space.names) if not name.startswith("camera.r")]
    pulls = (estimate.values - space.reduce(truth)) / estimate.standard_errors
    assert np.abs(pulls[rest]).max() < 4.5


def test_a_tracker_that_is_not_identified_stays_where_it_is() -> None:
    rig = parse_rig(
        rig_text("shoulder")[0] + tracker_text().replace("identify = true", "identify = false")
    )
    space = ParameterSpace.of(parameters(rig))
    _, observed = averaged_nature(rig, 1, 20, 10)
    near = located(model_of(rig), space, observed, space.nominal)
    np.testing.assert_array_equal(near, space.nominal)


def test_an_arm_in_free_space_is_calibrated_by_a_camera_alone() -> None:
    rig = free_arm(tracker_text())
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed, _ = posed(rig, 2, 80)
    estimate = likelihood.identify(model, space, observed)
    assert estimate.status is Status.CONVERGED
    assert abs(estimate.misfit - 1) < 5 * np.sqrt(2 / estimate.freedoms)
    # The end frame is where the markers say: shifting or turning it on the last link is undone
    # by the markers' offsets, and the last joint's zero with it.
    assert 0 < estimate.held.shape[1] < 6
    gap = estimate.jacobian @ (estimate.values - space.reduce(truth))
    assert gap @ gap / (len(space.names) - estimate.held.shape[1]) < 3.0


def test_from_simulated_session_to_solution(tmp_path: Path) -> None:
    """The free arm, driven by its plan before the camera: recording, averaging, selection, solve."""
    text = free_arm_text(tracker_text()) + PLAN
    truth = simulate(parse_rig(text), text, tmp_path / "arm.mcap", seed=2)
    solution = solve(read_recording(tmp_path / "arm.mcap"), poses=40)
    estimate = solution.estimate
    assert estimate.status is Status.CONVERGED
    assert abs(estimate.misfit - 1) < 5 * np.sqrt(2 / estimate.freedoms)
    for name in ("joint2.a", "joint3.a", "joint3.theta_offset", "camera.x"):
        k = estimate.space.names.index(name)
        parameter = next(p for p in estimate.space.table if p.name == name)
        gap = estimate.values[k] - truth.parameters[parameter.name]
        assert abs(gap) < 4.5 * estimate.standard_errors[k], name
