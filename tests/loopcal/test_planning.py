"""`loopcal plan`: a plan that can be run, and predictions that a session of it keeps."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from loopcal.cli import app
from loopcal.planning import calibrated_values, plan_text
from loopcal.solving import write_json
from recordings.reader import read_recording
from recordings.rig import (
    Plan,
    SerialMechanism,
    load_plan,
    load_rig,
    parameters,
    parse_rig,
    rig_text,
    visits,
)
from sim_devices.simulate import simulate
from solver.errors import MechanismError
from solver.estimate import likelihood
from solver.estimate.nuisance import Observations
from solver.mechanism.model import model_of
from solver.poses.planning import SessionPlan, mean_sigma, plan_session
from solver.poses.reach import close_holding
from solver.result import result
from solver.solve import Solution, solve

RUN = CliRunner()


@cache
def planned(name: str, poses: int = 40) -> SessionPlan:
    return plan_session(load_rig(name), poses=poses)


def with_plan(name: str) -> str:
    """The bundled rig's text with the planned session in place of its own plan."""
    text = rig_text(name)[0]
    rig = load_rig(name)
    return text[: text.index("[plan]")] + plan_text(rig, planned(name))


def session(name: str, file: Path, seed: int) -> tuple[Solution, np.ndarray]:
    """A simulated session of the planned rig, solved with all its poses, and the standard errors."""
    text = with_plan(name)
    simulate(parse_rig(text, name), text, file, seed=seed)
    recording = read_recording(file)
    assert recording.faults == ()
    solved = solve(recording, poses=1000)
    return solved, np.sqrt(np.diag(solved.estimate.covariance)) / solved.estimate.inflation


def test_a_driven_session_reaches_the_predicted_errors(tmp_path: Path) -> None:
    solved, reached = session("arm", tmp_path / "session.mcap", seed=3)
    assert len(solved.table.counts) == 60
    predicted = planned("arm").predicted
    assert predicted is not None
    assert planned("arm").followed is None
    ratio = reached / predicted.errors
    assert (np.abs(ratio - 1.0) < 0.25).all(), ratio
    assert (predicted.low == predicted.high).all()


def test_sessions_by_hand_reach_what_is_predicted_of_a_hand(tmp_path: Path) -> None:
    plan = planned("shoulder")
    predicted, followed = plan.predicted, plan.followed
    assert predicted is not None
    assert followed is not None
    ratios = []
    for seed in (3, 5, 7, 8):
        solved, reached = session("shoulder", tmp_path / f"{seed}.mcap", seed)
        # By hand the mechanism also stands before it is moved for the first time.
        assert len(solved.table.counts) in (60, 61, 62)
        # The hand rests longer than the plan asks for.
        rests = solved.table.sigma / mean_sigma(load_rig("shoulder"), plan.plan)
        ratios.append(reached / np.median(rests) / predicted.errors)
    assert 0.85 < np.median(ratios) < 1.2, ratios
    within = (ratios > 0.95 * predicted.low / predicted.errors) & (
        ratios < 1.05 * predicted.high / predicted.errors
    )
    assert within.mean() > 0.6, ratios
    # Better poses than a hand picks would do with smaller errors, and the plan says so.
    assert (followed.errors < predicted.errors).all()
    assert (predicted.low < predicted.errors).all()
    assert (predicted.errors < predicted.high).all()


def test_a_plate_that_follows_the_suggestions_reaches_the_predicted_errors() -> None:
    rig, session = load_rig("shoulder"), planned("shoulder")
    model, rng = model_of(rig), np.random.default_rng(2)
    x = session.space.nominal
    stops = [visit.pose for visit in visits(session.plan)]
    counts = model.linearise(session.coordinates[stops], x, np.zeros((len(x), 0))).readings
    sigma = np.tile(mean_sigma(rig, session.plan), (len(stops), 1))
    observed = Observations(counts + sigma * rng.standard_normal(counts.shape), sigma)
    got = likelihood.identify(model, session.space, observed)
    assert session.followed is not None
    errors = session.followed.errors
    ratio = np.sqrt(np.diag(got.covariance)) / errors
    assert (np.abs(ratio - 1.0) < 0.25).all(), ratio
    assert (np.abs(got.values - session.space.reduce(x)) < 4 * errors).all()


def test_the_arm_is_driven_by_the_pair_that_moves_the_others_most() -> None:
    assert planned("arm").plan.drives == ("joint5", "joint6")


def test_stops_lie_within_limits_and_so_do_the_straight_ways_between_any_two() -> None:
    rig, session = load_rig("arm"), planned("arm")
    model = model_of(rig)
    x = np.array([p.nominal for p in parameters(rig)])
    drives = tuple(session.coordinate_names.index(name) for name in session.plan.drives)
    rng = np.random.default_rng(0)
    pairs = rng.choice(len(session.coordinates), (150, 2))
    at = session.coordinates[pairs[:, 0]].copy()
    start, end = (session.coordinates[pairs[:, k]][:, list(drives)] for k in (0, 1))
    for share in np.linspace(0, 1, 31):
        at[:, drives] = (1 - share) * start + share * end
        at, closed = close_holding(model, at, x, drives)
        assert closed.all()
        for j, joint in enumerate(rig.mechanism.joints):
            if joint.limits is not None:
                assert (at[:, j] > joint.limits.low).all()
                assert (at[:, j] < joint.limits.high).all()
    assert np.abs(at - session.coordinates[pairs[:, 1]]).max() < 1e-6


def test_order_makes_short_moves() -> None:
    session = planned("arm")
    drives = [session.coordinate_names.index(name) for name in session.plan.drives]
    points = session.coordinates[:, drives]
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    shuffled = points[np.random.default_rng(0).permutation(len(points))]
    assert length < 0.35 * np.linalg.norm(np.diff(shuffled, axis=0), axis=1).sum()


def test_more_poses_promise_smaller_errors() -> None:
    sizes = planned("shoulder").by_poses
    worst = [float(size.errors[size.worst]) for size in sizes]
    assert len(sizes) > 5
    assert worst == sorted(worst, reverse=True)


def test_the_file_is_a_plan_and_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "plan.toml"
    done = RUN.invoke(app, ["plan", "shoulder", "--poses", "12", "-o", str(file)])
    assert done.exit_code == 0, done.output
    assert "How many poses do I need?" in done.output
    plan = load_plan(file)
    assert (plan.mode, plan.poses) == ("by-hand", 12)
    assert file.read_text("utf-8").count("plate.rz") == 12
    again = RUN.invoke(app, ["plan", "shoulder", "-o", str(file)])
    assert again.exit_code == 2


def test_plans_from_a_result(tmp_path: Path) -> None:
    rig = load_rig("shoulder")
    text = rig_text("shoulder")[0]
    recorded, solved_file = tmp_path / "a.mcap", tmp_path / "a.json"
    simulate(rig, text, recorded, seed=5, poses=20)
    solved = solve(read_recording(recorded))
    write_json(result(solved), solved_file)
    values = calibrated_values(rig, solved_file)
    assert values == pytest.approx(solved.estimate.parameters)
    assert values == pytest.approx(calibrated_values(rig, recorded))
    done = RUN.invoke(app, ["plan", "arm", "--from", str(solved_file)])
    assert done.exit_code == 2
    assert plan_session(rig, values=values, poses=10).plan.poses == 10


def test_refuses_what_cannot_be_planned() -> None:
    text = rig_text("arm")[0].replace('constraint = "rigid"', 'constraint = "ball"')
    with pytest.raises(MechanismError, match=r"mobility 5; drives are planned for 1 to 3"):
        plan_session(parse_rig(text, "arm"))
    nothing = rig_text("shoulder")[0].replace("identify = true", "identify = false")
    with pytest.raises(MechanismError, match="nothing to plan for"):
        plan_session(parse_rig(nothing, "shoulder"))


def by_hand(closure: str) -> str:
    """The arm without its hinge, its last link held by a person, with a by-hand plan."""
    text = rig_text("arm")[0].replace('constraint = "rigid"', f'constraint = "{closure}"')
    return text[: text.index("[plan]")] + '[plan]\nmode = "by-hand"\nposes = 25\n'


def test_an_arm_with_many_freedoms_is_planned_by_hand(tmp_path: Path) -> None:
    text = by_hand("ball")
    rig = parse_rig(text, "arm")
    plan = plan_session(rig)
    assert (plan.plan.mode, plan.plan.drives, plan.plan.poses) == ("by-hand", (), 25)
    assert plan.coordinates.shape == (25, 8)
    assert isinstance(rig.mechanism, SerialMechanism)
    model, x = model_of(rig), plan.space.nominal
    closure = model.linearise(plan.coordinates, x, plan.space.expansion[:, :0]).closure
    assert np.abs(closure).max() < 1e-8
    for j, joint in enumerate(rig.mechanism.joints):
        if joint.limits is not None:
            assert (plan.coordinates[:, j] > joint.limits.low).all()
            assert (plan.coordinates[:, j] < joint.limits.high).all()
    assert plan.predicted is not None
    assert (plan.predicted.high >= plan.predicted.low).all()
    offset = plan.space.names.index("joint4.theta_offset")
    assert plan.predicted.high[offset] > 1.2 * plan.predicted.low[offset]
    # Held by a ball, the arm does not show how its last link is twisted.
    assert "joint7.alpha, which no pose shows" in plan.held
    written = load_plan_text(plan_text(rig, plan), tmp_path)
    assert (written.mode, written.poses) == ("by-hand", 25)


def load_plan_text(text: str, folder: Path) -> Plan:
    file = folder / "plan.toml"
    file.write_text(text, "utf-8")
    return load_plan(file)


def test_few_poses_by_hand_say_what_they_leave_open() -> None:
    plan = plan_session(load_rig("shoulder-all"), poses=8)
    assert plan.predicted is None
    assert plan.held == (
        "the common scale of all lengths and gains",
        "the scale of B1 with its legs alone (A1, d1, A2, d2)",
    )
    # Of what can be determined beside these scales more poses determine all.
    assert {size.poses for size in plan.by_poses} >= {40, 100}
    assert "leave open" in plan_text(load_rig("shoulder-all"), plan)


TRACKER = """
[[tracker]]
name = "cam"
x_m = { nominal = 1.0, uncertainty = 0.01, identify = true }
y_m = { nominal = 0.3, uncertainty = 0.01, identify = true }
z_m = { nominal = 0.2, uncertainty = 0.01, identify = true }
[[tracker.marker]]
name = "M"
x_mm = 100
y_mm = 0
z_mm = 0
"""
TRACKER += "".join(
    f'[[channel]]\nname = "m{axis}"\nsenses = "M.{axis}"\ngain_mm_per_count = 0.01\nnoise_counts = 5\n'
    for axis in "xyz"
)


def test_a_tracker_is_counted_in_the_prediction() -> None:
    text = rig_text("arm")[0]
    begin = text.index("[plan]")
    watched = plan_session(parse_rig(text[:begin] + TRACKER + text[begin:]), poses=15)
    plain = planned("arm", 15)
    assert watched.plan.drives == plain.plan.drives
    assert watched.predicted is not None
    assert plain.predicted is not None
    errors = dict(zip(watched.space.names, watched.predicted.errors, strict=True))
    assert {"cam.x", "cam.y", "cam.z"} < set(errors)
    assert all(np.isfinite(list(errors.values())))
    # Who sees the end as well cannot know less; other poses were chosen, so nearly.
    shared = np.array([errors[name] for name in plain.space.names])
    assert (shared < 1.5 * plain.predicted.errors).all()
    assert np.median(shared / plain.predicted.errors) < 1.0
