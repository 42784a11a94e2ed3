"""Simulated recordings: the same things as in a capture's, reproducible, and no truth."""

import json

import numpy as np
import pytest

from recordings.errors import RecordingError
from recordings.events import Mode
from recordings.reader import read_recording
from recordings.rig import parse_rig, rig_text, visits
from sim_devices.plant.chain import Chain, chain_geometry
from sim_devices.plant.errors import BadEffect, CannotSimulate, TruthNotWritten
from sim_devices.plant.session import play
from sim_devices.simulate import EPOCH_NS, simulate


def run(tmp_path, name, text=None, file="out.mcap", **options):
    text = rig_text(name)[0] if text is None else text
    path = tmp_path / file
    truth = simulate(parse_rig(text), text, path, **options)
    return read_recording(path), truth, path


def dwell_means(recording):
    """(dwells, channels) mean reading through nominal gain and offset [rad or m]."""
    rows = []
    for dwell in recording.dwells:
        row = []
        for channel in recording.rig.channels:
            readings = recording.readings[channel.name]
            inside = (readings.time_ns >= dwell.start_ns) & (readings.time_ns <= dwell.end_ns)
            row.append((readings.raw[inside] - channel.zero_count).mean() * channel.gain.nominal)
        rows.append(row)
    return np.array(rows)


def test_a_driven_session_is_recorded_as_a_capture_would(tmp_path):
    recording, _, _ = run(tmp_path, "arm", poses=12, seed=2)
    plan = recording.rig.plan
    assert [(d.pose, d.visit) for d in recording.dwells] == [
        (v.pose, v.visit) for v in visits(plan, 12)
    ]
    assert all(d.end_ns - d.start_ns == round(plan.dwell * 1e9) for d in recording.dwells)
    commands = recording.mode_commands
    freed = {c.joint for c in commands if c.mode is Mode.FREE}
    assert freed == {"joint1", "joint2", "joint3", "joint4", "joint7"}
    held = [c for c in commands if c.mode is Mode.POSITION]
    assert len(held) == 2 * len(recording.dwells)
    assert {c.joint for c in held} == set(plan.drives)
    reports = [r for r in recording.mode_reports if r.joint == "joint5"]
    assert {r.mode for r in reports} == {Mode.POSITION}
    assert all(r.error_code == 0 for r in reports)
    assert recording.faults == ()
    assert recording.session.operator == "simulated"
    assert recording.session.start_ns == EPOCH_NS


def test_drives_stand_at_their_targets_during_dwells(tmp_path):
    recording, _, _ = run(tmp_path, "arm", poses=10)
    targets = [
        [c.target_raw for c in recording.mode_commands if c.joint == j and c.mode is Mode.POSITION]
        for j in ("joint5", "joint6")
    ]
    raw = recording.readings["q5"].raw, recording.readings["q6"].raw
    time_ns = recording.readings["q5"].time_ns
    for k, dwell in enumerate(recording.dwells):
        inside = (time_ns >= dwell.start_ns) & (time_ns < dwell.end_ns)
        assert raw[0][inside].mean() == pytest.approx(targets[0][k], abs=1.0)
        assert raw[1][inside].mean() == pytest.approx(targets[1][k], abs=2.0)


def test_readings_come_at_the_plans_rate_with_sequence_and_device_time(tmp_path):
    recording, _, _ = run(tmp_path, "arm", poses=3)
    lengths = {len(r.raw) for r in recording.readings.values()}
    assert len(lengths) == 1
    for readings in recording.readings.values():
        count = len(readings.raw)
        assert readings.sequence.tolist() == list(range(count))
        gaps = np.diff(readings.time_ns)
        assert gaps.min() >= 0
        assert gaps.mean() == pytest.approx(10e6, rel=1e-3)
        assert 1e4 < gaps.std() < 1e6
        np.testing.assert_allclose(np.diff(readings.device_time_ns), 10e6, rtol=1e-3)
    assert np.array_equal(recording.readings["q6"].time_ns, recording.readings["q7"].time_ns)
    assert not np.array_equal(recording.readings["q1"].time_ns, recording.readings["q2"].time_ns)


def test_the_ledger_is_whole(tmp_path):
    recording, _, _ = run(tmp_path, "arm", poses=3)
    ledger = recording.ledger
    assert set(ledger) == set(recording.readings)
    for source, entry in ledger.items():
        assert entry.unaccounted == 0
        assert entry.expected == entry.received == len(recording.readings[source].raw)


def test_readings_close_the_true_loop(tmp_path):
    recording, truth, _ = run(tmp_path, "arm", poses=15, seed=4)
    chain = Chain(recording.rig.mechanism)
    means = dwell_means(recording)
    variables = np.column_stack([np.zeros(len(means)), means])

    def best_closure(values):
        geometry = chain_geometry(recording.rig.mechanism, values)
        here = variables.copy()
        here[:, 0] = np.deg2rad(130)
        for _ in range(20):
            error, rate = chain.closure(geometry, here)
            turn = rate[:, :, 0]
            here[:, 0] -= np.sum(turn * error, axis=1) / np.sum(turn**2, axis=1)
        return np.sqrt(np.mean(chain.closure(geometry, here)[0] ** 2))

    nominal = {
        **truth.parameters,
        **{f"joint{j}.theta_offset": p for j, p in zip((1, 2), (0.173, -2.143), strict=True)},
    }
    assert best_closure(truth.parameters) < 3e-4
    assert best_closure(nominal) > 3e-3


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_the_same_seed_gives_the_same_bytes(tmp_path, name):
    options = {"poses": 4, "seed": 9, "hide": ["random"]}
    *_, one = run(tmp_path, name, file="one.mcap", **options)
    *_, two = run(tmp_path, name, file="two.mcap", **options)
    assert one.read_bytes() == two.read_bytes()
    *_, other = run(tmp_path, name, file="other.mcap", **{**options, "seed": 10})
    assert other.read_bytes() != one.read_bytes()


def test_by_hand_there_are_no_dwells_and_no_modes(tmp_path):
    recording, _, _ = run(tmp_path, "shoulder", poses=5)
    assert recording.dwells == ()
    assert recording.mode_commands == ()
    assert len(recording.readings["d1"].raw) > 300
    assert recording.ledger["d4"].unaccounted == 0


def test_truth_goes_to_its_own_file_only(tmp_path):
    hide = ["nonlinearity@q6=1%"]
    path = tmp_path / "truth.json"
    recording, truth, file = run(tmp_path, "arm", poses=4, seed=77, hide=hide, truth_path=path)
    document = json.loads(path.read_text("utf-8"))
    assert document["seed"] == 77
    assert document["effects"][0]["size"] == truth.effects[0].size
    assert recording.rig_toml == rig_text("arm")[0]
    content = file.read_bytes()
    assert b"nonlinearity" not in content
    assert "77" not in recording.session.notes + recording.session.software
    simulate(recording.rig, recording.rig_toml, tmp_path / "plain.mcap", poses=4, seed=77)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.mcap", "plain.mcap", "truth.json"]


def test_a_pose_out_of_reach_is_left_out_with_a_fault(tmp_path):
    text = rig_text("arm")[0]
    start = text.index("corners_deg")
    end = text.index("\n", start)
    targets = "targets_deg = [[60, -20], [-60, -20], [65, -30], [70, 120]]"
    text = text[:start] + targets + text[end:]
    recording, _, _ = run(tmp_path, "arm", text)
    reached = {dwell.pose for dwell in recording.dwells}
    assert reached == {0, 2}
    assert {fault.source for fault in recording.faults} == {"joint5", "joint6"}
    codes = {r.error_code for r in recording.mode_reports if r.mode is Mode.FAULT}
    assert codes == {0x8611, 0x8612}


def test_too_many_drives_are_an_error(tmp_path):
    text = rig_text("arm")[0]
    start = text.index("drives = ")
    text = (
        text[:start]
        + 'drives = ["joint5", "joint6", "joint1"]\ntargets_deg = [[60, -20, 100]]\n'
        + text[text.index("move_deg_per_s", start) :]
    )
    with pytest.raises(CannotSimulate, match=r"3 joints.*only 2 freedoms.*'joint1'"):
        run(tmp_path, "arm", text)
    assert list(tmp_path.iterdir()) == []


def test_one_drive_alone_leaves_the_rest_compliant(tmp_path):
    text = rig_text("arm")[0]
    start = text.index("drives = ")
    text = (
        text[:start]
        + 'drives = ["joint5"]\ntargets_deg = [[60], [70], [55]]\n'
        + text[text.index("move_deg_per_s", start) :]
    )
    recording, _, _ = run(tmp_path, "arm", text)
    assert recording.faults == ()
    # Joint 5 is back at 55 deg at every visit of pose 2, the others are wherever they were left.
    means = dwell_means(recording)
    assert {dwell.pose for dwell in recording.dwells} == {0, 1, 2}
    np.testing.assert_allclose(
        means[[d.pose == 2 for d in recording.dwells], 4], np.deg2rad(55), atol=1e-5
    )


def test_a_session_needs_a_plan(tmp_path):
    with pytest.raises(CannotSimulate, match=r"no \[plan\]"):
        run(tmp_path, "arm", rig_text("arm")[0].partition("[plan]")[0])
    assert list(tmp_path.iterdir()) == []


def test_a_chain_of_joints_is_not_moved_by_hand(tmp_path, four_bar_text):
    text = four_bar_text.partition("[plan]")[0] + '[plan]\nmode = "by-hand"\n'
    with pytest.raises(CannotSimulate, match="needs a driven plan"):
        run(tmp_path, "four-bar", text)


def test_bad_options_leave_nothing_behind(tmp_path):
    with pytest.raises(CannotSimulate, match="0 poses"):
        run(tmp_path, "arm", poses=0)
    with pytest.raises(CannotSimulate, match="seed is -1"):
        run(tmp_path, "arm", seed=-1)
    with pytest.raises(BadEffect):
        run(tmp_path, "arm", hide=["nonsense"])
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path):
    truth = tmp_path / "truth.json"
    truth.write_text("mine")
    with pytest.raises(TruthNotWritten):
        run(tmp_path, "arm", poses=2, truth_path=truth)
    assert not (tmp_path / "out.mcap").exists()
    (tmp_path / "out.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingError, match="exists already"):
        run(tmp_path, "arm", poses=2, truth_path=tmp_path / "new.json")
    assert (tmp_path / "out.mcap").read_bytes() == b"mine"
    assert not (tmp_path / "new.json").exists()


def test_a_planar_loop_is_played(four_bar):
    from sim_devices.plant.creation import make_nature

    played = play(make_nature(four_bar, 0))
    elbow, crank = played.course.value["c2"], played.course.value["c1"]
    assert all(not stop.faults for stop in played.stops)
    assert crank[-1] == pytest.approx(np.deg2rad(200))
    # Law of cosines: the rocker pivot is 0.3 from the crank's, the arms are 0.1, 0.3 and 0.25.
    inner = np.pi - np.abs(elbow)
    assert np.ptp(inner) > 0.3
    assert np.abs(np.diff(elbow)).max() < 0.05
