"""Sessions of rigs with several fixtures: played in each, carried between, and solved with their distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recordings.events import Mode
from recordings.reader import read_recording
from recordings.recording import Recording
from recordings.rig import parse_rig
from sim_devices.plant.creation import make_nature
from sim_devices.plant.errors import CannotSimulate, MechanismDoesNotClose
from sim_devices.plant.fixtures import CARRY_S, drive_through
from sim_devices.plant.live import make_plant
from sim_devices.plant.session import play, resting
from sim_devices.simulate import simulate
from sim_devices.truth import Truth, draw_truth
from solver.solve import solve

RIG = """
schema = 1
name = "planar"
[mechanism]
family = "serial"
closure = { constraint = "hinge" }
[mechanism.tip]
x_m = 0.15
[[mechanism.joint]]
name = "shoulder"
a_m = { nominal = 0.3, uncertainty = 0.003, identify = true }
home_deg = 45
[[mechanism.joint]]
name = "elbow"
theta_offset_deg = { nominal = 0, uncertainty = 1, identify = true }
a_m = { nominal = 0.25, uncertainty = 0.003, identify = true }
home_deg = -80
[[mechanism.joint]]
name = "wrist"
theta_offset_deg = { nominal = 0, uncertainty = 1, identify = true }
home_deg = -60
[[mechanism.fixture]]
name = "left"
x_m = { nominal = 0.38, uncertainty = 0.02, identify = true }
y_m = { nominal = 0.05, uncertainty = 0.02, identify = true }
[[mechanism.fixture]]
name = "right"
x_m = { nominal = 0.43, uncertainty = 0.02, identify = true }
y_m = { nominal = 0.05, uncertainty = 0.02, identify = true }
[[mechanism.distance]]
between = ["left", "right"]
distance_mm = { nominal = 50, uncertainty = 0.02 }
[[channel]]
name = "c1"
senses = "shoulder"
gain_deg_per_count = 0.001
noise_counts = 2
count_range = [-360000, 360000]
[[channel]]
name = "c2"
senses = "elbow"
gain_deg_per_count = 0.001
noise_counts = 2
count_range = [-360000, 360000]
[[channel]]
name = "c3"
senses = "wrist"
gain_deg_per_count = 0.001
noise_counts = 2
count_range = [-360000, 360000]
[plan]
mode = "driven"
drives = ["shoulder"]
targets_deg = [[25], [30], [35], [40], [45], [50], [55], [60]]
move_deg_per_s = 30
dwell_s = 0.2
revisit = { poses = 2, visits = 2 }
"""


def session(tmp_path: Path, text: str = RIG, **options: int) -> tuple[Recording, Truth]:
    file = tmp_path / "session.mcap"
    truth = simulate(parse_rig(text), text, file, **options)
    return read_recording(file), truth


def test_the_plan_is_played_in_every_fixture_and_dwells_say_which(tmp_path: Path) -> None:
    recording, _ = session(tmp_path, seed=2)
    assert recording.faults == ()
    dwells = recording.dwells
    assert [d.fixture for d in dwells] == ["left"] * 10 + ["right"] * 10
    poses = {name: [d.pose for d in dwells if d.fixture == name] for name in ("left", "right")}
    assert set(poses["left"]) == set(range(8))
    assert [pose - 8 for pose in poses["right"]] == poses["left"]
    assert dwells[10].start_ns - dwells[9].end_ns > CARRY_S * 1e9
    assert [mark.text for mark in recording.marks] == [
        "the endpoint goes from fixture 'left' to 'right'"
    ]
    (freed,) = [c for c in recording.mode_commands if c.mode is Mode.FREE]
    assert (freed.joint, freed.time_ns) == ("shoulder", dwells[9].end_ns)


def test_each_stay_closes_in_its_own_fixture_and_the_way_between_is_smooth() -> None:
    rig = parse_rig(RIG)
    nature = make_nature(rig, 4)
    assert rig.plan is not None
    passage = drive_through(nature, rig.plan)
    time_s = np.arange(0.0, passage.stops[-1].leave_s, 0.02)
    seen = list(passage.pieces(time_s))
    assert sum(len(part) for _, part, _ in seen) == len(time_s)
    for stay, (loop, part_s, variables) in zip(passage.stays, seen, strict=True):
        assert loop is nature.loops[stay.tour.stops[0].fixture]
        inside = part_s >= stay.begin_s
        error, _ = loop.closure(variables[inside], part_s[inside])
        assert np.abs(error).max() < 1e-9
        assert (loop is nature.mechanism) == inside.all()
    joined = np.vstack([variables for *_, variables in seen])
    # Nothing jumps: no joint is faster than the drive by more than the lever of the linkage.
    assert np.abs(np.diff(joined, axis=0)).max() < 0.06


def test_the_session_solves_to_the_truth_through_the_known_distance(tmp_path: Path) -> None:
    recording, truth = session(tmp_path, seed=6)
    solved = solve(recording, poses=1000)
    found = solved.estimate
    assert len(solved.table.counts) == 20
    assert solved.identifiability.combinations == ()
    true = np.array([truth.parameters[name] for name in found.space.names])
    off = (found.values - true) / np.sqrt(np.diag(found.covariance))
    assert np.abs(off).max() < 4.0
    nominal = (true - found.space.reduce(found.space.nominal)) / np.sqrt(np.diag(found.covariance))
    assert np.abs(nominal).max() > 20.0


def test_rests_of_all_fixtures_size_an_effect() -> None:
    nature = make_nature(parse_rig(RIG), 1, ["nonlinearity@c2=1%"])
    assert resting(nature)["c2"].shape == (20,)
    assert len(play(nature, 3).stops) == 2 * (3 + 2)


def test_a_fixture_out_of_reach_is_named(tmp_path: Path) -> None:
    far = RIG.replace("x_m = { nominal = 0.43", "x_m = { nominal = 1.43")
    far = far.replace("distance_mm = { nominal = 50", "distance_mm = { nominal = 1050")
    with pytest.raises(MechanismDoesNotClose, match="in the fixture 'right': the loop"):
        session(tmp_path, far)
    assert list(tmp_path.iterdir()) == []


def test_at_a_live_bench_nobody_carries_the_endpoint() -> None:
    with pytest.raises(CannotSimulate, match="2 fixtures, and at a live bench nobody"):
        make_plant(make_nature(parse_rig(RIG), 0))


def test_drawn_fixtures_keep_the_known_distance_and_nothing_else_moves() -> None:
    rig = parse_rig(RIG)
    apart = RIG.index("[[mechanism.distance]]")
    loose = parse_rig(RIG[:apart] + RIG[RIG.index("[[channel]]") :])
    distances = []
    for seed in range(40):
        held, free = draw_truth(rig, seed).parameters, draw_truth(loose, seed).parameters
        step = [held[f"right.{axis}"] - held[f"left.{axis}"] for axis in "xyz"]
        distances.append(float(np.linalg.norm(step)))
        assert all(held[n] == free[n] for n in held if n.split(".")[0] not in ("left", "right"))
        assert any(held[n] != free[n] for n in held)
    assert np.mean(distances) == pytest.approx(0.05, abs=1.5e-5)
    assert 1e-5 < np.std(distances) < 4e-5


def test_distances_that_cannot_be_are_refused() -> None:
    third = '[[mechanism.fixture]]\nname = "third"\nx_m = 0.1\n[[mechanism.distance]]\n'
    text = RIG.replace("[[mechanism.distance]]", third + "between = ['left', 'third']\n", 1)
    text = text.replace(
        "['left', 'third']\n",
        "['left', 'third']\ndistance_mm = { nominal = 1, uncertainty = 0.01 }\n"
        "[[mechanism.distance]]\nbetween = ['right', 'third']\n"
        "distance_mm = { nominal = 200, uncertainty = 0.01 }\n[[mechanism.distance]]\n",
    )
    with pytest.raises(CannotSimulate, match="no places of the fixtures"):
        draw_truth(parse_rig(text), 0)
