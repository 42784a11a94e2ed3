"""By-hand sessions on a bench without wires: standstill is found, and found once."""

from __future__ import annotations

from daq import CaptureOptions, Ending, capture
from recordings.events import Mode
from recordings.reader import read_recording
from recordings.rig import visits


def run(bench, path, **more):
    return capture(bench.rig, bench.toml, path, links=bench.links, clock=bench.clock, **more)


def hand(holds):
    """Legs that stay where they are for 1 s and move for 1 s, at most ``holds`` times."""

    def values(seconds):
        cycle, phase = divmod(seconds, 2.0)
        at = min(cycle + max(0.0, phase - 1.0), holds)
        lengths = {"d1": 0.097, "d2": 0.1003, "d3": 0.0951, "d4": 0.1002}
        return {name: length + 0.004 * at for name, length in lengths.items()}

    return values


def test_every_hold_becomes_one_dwell_numbered_in_order(shoulder, tmp_path):
    shoulder.values = hand(99)
    summary = run(shoulder, tmp_path / "shoulder.mcap")
    stops = len(visits(shoulder.rig.plan))
    assert summary.ending is Ending.COMPLETE
    assert [(dwell.pose, dwell.visit) for dwell in summary.dwells] == [(i, 0) for i in range(stops)]
    for index, dwell in enumerate(summary.dwells):
        begin = dwell.start_ns / 1e9 - 1_700_000_000 - 2.0 * index
        assert 0.0 <= begin <= 0.6
        assert dwell.end_ns - dwell.start_ns == round(shoulder.rig.plan.dwell * 1e9)
    assert tuple(read_recording(tmp_path / "shoulder.mcap").dwells) == summary.dwells


def test_a_long_hold_is_one_dwell_and_the_operator_is_asked_to_move(shoulder, tmp_path):
    shoulder.values = hand(0)
    hints = []
    summary = run(
        shoulder,
        tmp_path / "shoulder.mcap",
        on_progress=lambda progress: hints.append(progress.hint),
        options=CaptureOptions(max_duration_s=20.0),
    )
    assert summary.ending is Ending.STOPPED
    assert "20 s" in summary.why
    assert len(summary.dwells) == 1
    assert hints[-2] == "move to a new pose"


def test_a_hand_that_never_rests_records_no_dwell_and_is_asked_to_hold_still(shoulder, tmp_path):
    shoulder.values = lambda seconds: {"d2": 0.1 + 0.002 * seconds}
    hints = []
    summary = run(
        shoulder,
        tmp_path / "shoulder.mcap",
        on_progress=lambda progress: hints.append(progress.hint),
        options=CaptureOptions(max_duration_s=5.0),
    )
    assert summary.dwells == ()
    assert hints[-2] == "hold still"


def test_a_bump_at_the_same_place_is_not_a_new_pose(shoulder, tmp_path):
    shoulder.values = lambda seconds: {"d1": 0.097 + 0.003 * (3.0 < seconds < 3.3)}
    options = CaptureOptions(max_duration_s=8.0)
    summary = run(shoulder, tmp_path / "shoulder.mcap", options=options)
    assert len(summary.dwells) == 1


def test_drives_are_free_while_a_hand_moves_the_mechanism(arm, tmp_path):
    changes = {"mode": "by-hand", "drives": (), "corners": None}
    plan = arm.rig.plan.model_copy(update=changes)
    modes = []
    summary = run(
        arm,
        tmp_path / "arm.mcap",
        plan_override=plan,
        on_progress=lambda progress: modes.append(set(arm.modes.values())),
        options=CaptureOptions(max_duration_s=3.0),
    )
    assert summary.ending is Ending.STOPPED
    assert modes[-2:] == [{Mode.FREE}, {Mode.OFF}]
    assert set(arm.modes.values()) == {Mode.OFF}
