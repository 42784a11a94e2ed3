"""Driven sessions on a bench without wires: order of commands, dwells, faults, endings."""

from __future__ import annotations

import os
import signal
from itertools import pairwise

import pytest

from daq import (
    CannotRecord,
    CaptureOptions,
    Ending,
    NotArmed,
    NotReady,
    Phase,
    PlanNotPossible,
    Stop,
    StopRequested,
    capture,
)
from drivers import DeviceSilent, LinkBroken, PortNotFound
from recordings.errors import RecordingError, RigError
from recordings.events import Dwell, Mode
from recordings.reader import read_recording
from recordings.rig import visits
from recordings.writer import Writer


def run(bench, path, **more):
    return capture(bench.rig, bench.toml, path, links=bench.links, clock=bench.clock, **more)


def position_joints(log):
    """Joints in position mode after each command."""
    held: set[str] = set()
    for joint, mode, target in log:
        if target is None:
            held = held | {joint} if mode is Mode.POSITION else held - {joint}
        yield set(held)


def test_a_session_visits_every_stop_and_records_it(arm, tmp_path):
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.COMPLETE, summary.why
    expected = [(visit.pose, visit.visit) for visit in visits(arm.rig.plan)]
    assert [(dwell.pose, dwell.visit) for dwell in summary.dwells] == expected
    assert summary.poses == 4
    recording = read_recording(tmp_path / "arm.mcap")
    assert tuple(recording.dwells) == summary.dwells
    for dwell in summary.dwells:
        assert dwell.end_ns - dwell.start_ns == round(arm.rig.plan.dwell * 1e9)


def test_the_drives_stand_at_the_targets_while_they_dwell(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap")
    recording = read_recording(tmp_path / "arm.mcap")
    stops = {(visit.pose, visit.visit): visit.targets for visit in visits(arm.rig.plan)}
    for dwell in recording.dwells:
        for joint, target in zip(arm.rig.plan.drives, stops[dwell.pose, dwell.visit], strict=True):
            channel = arm.rig.sensed_by(joint)
            readings = recording.readings[channel.name]
            inside = (readings.time_ns >= dwell.start_ns) & (readings.time_ns <= dwell.end_ns)
            value = channel.gain.nominal * (readings.raw[inside] - channel.zero_count)
            assert abs(value.mean() - target) < 0.01


def test_never_more_joints_in_position_mode_than_the_plan_drives(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap")
    most = max(len(held) for held in position_joints(arm.log))
    assert most == len(arm.rig.plan.drives)
    first = next(i for i, (_, mode, _) in enumerate(arm.log) if mode is Mode.POSITION)
    freed = {joint for joint, mode, _ in arm.log[:first] if mode is Mode.FREE}
    assert freed == set(arm.modes) - set(arm.rig.plan.drives)


def test_targets_move_in_small_steps(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap")
    gain = arm.rig.sensed_by(arm.rig.plan.drives[0]).gain.nominal
    for joint in arm.rig.plan.drives:
        targets = [target for name, _, target in arm.log if name == joint and target is not None]
        gain = arm.rig.sensed_by(joint).gain.nominal
        steps = [abs(b - a) * gain for a, b in pairwise(targets)]
        assert max(steps) <= (0.1 + 0.02) * arm.rig.plan.move + gain


def test_every_command_is_recorded_with_its_cause(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap")
    commands = read_recording(tmp_path / "arm.mcap").mode_commands
    recorded = [(c.joint, c.mode, c.target_raw) for c in commands]
    # At the end all drives are told at once, whichever thread comes first.
    end = -len(arm.modes)
    assert recorded[:end] == arm.log[:end]
    assert set(recorded[end:]) == set(arm.log[end:])
    assert all(command.cause for command in commands)


def test_all_drives_are_off_at_the_end_and_the_driven_ones_went_first(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap")
    assert set(arm.modes.values()) == {Mode.OFF}
    last = [joint for joint, mode, _ in arm.log[-len(arm.modes) :] if mode is Mode.OFF]
    assert set(last[:2]) == set(arm.rig.plan.drives)


def test_everything_that_does_not_answer_is_named_at_once(arm, tmp_path):
    arm.silent_devices = {"encoder2", "drive3"}
    arm.link("arm-wrist").open_error = PortNotFound("there is no port /tmp/loopcal-arm-wrist")
    with pytest.raises(NotReady) as caught:
        run(arm, tmp_path / "arm.mcap")
    assert len(caught.value.missing) == 3
    for words in ("encoder2", "q2", "drive3", "arm-wrist", "there is no port"):
        assert words in str(caught.value)
    assert not (tmp_path / "arm.mcap").exists()
    assert arm.log == []
    assert all(link.calls[-1] == "close" for link in arm.links)


def test_a_channel_that_never_delivers_is_named_and_nothing_is_written(arm, tmp_path):
    arm.mute_channels = {"q3", "q7"}
    with pytest.raises(NotReady) as caught:
        run(arm, tmp_path / "arm.mcap")
    assert [line.split("'")[1] for line in caught.value.missing] == ["q3", "q7"]
    assert not (tmp_path / "arm.mcap").exists()
    assert arm.log == []


def test_a_link_that_cannot_start_is_named(arm, tmp_path):
    arm.link("arm-can").break_at_s = 0.0
    arm.link("arm-can").break_with = DeviceSilent("encoder1 (node 1) did not answer")
    with pytest.raises(NotReady, match=r"arm-can.*encoder1"):
        run(arm, tmp_path / "arm.mcap")
    assert not (tmp_path / "arm.mcap").exists()


def test_nothing_is_overwritten_and_no_port_is_touched(arm, tmp_path):
    path = tmp_path / "arm.mcap"
    path.write_text("precious")
    with pytest.raises(CannotRecord, match="exists already"):
        run(arm, path)
    assert path.read_text() == "precious"
    assert all(link.calls == [] for link in arm.links)


def test_a_missing_folder_is_refused_before_any_port_is_touched(arm, tmp_path):
    with pytest.raises(CannotRecord, match="no folder"):
        run(arm, tmp_path / "nowhere" / "arm.mcap")
    assert all(link.calls == [] for link in arm.links)


def test_a_rig_without_a_plan_is_refused(arm, tmp_path):
    arm.rig = arm.rig.model_copy(update={"plan": None})
    with pytest.raises(PlanNotPossible, match="no \\[plan\\]"):
        run(arm, tmp_path / "arm.mcap")


def test_a_target_outside_the_count_range_is_refused(arm, tmp_path):
    plan = arm.rig.plan.model_copy(
        update={"corners": None, "targets": ((0.0, 0.0), (0.5, 2.0)), "poses": 2}
    )
    with pytest.raises(PlanNotPossible, match="count_range"):
        run(arm, tmp_path / "arm.mcap", plan_override=plan)
    assert all(link.calls == [] for link in arm.links)


def test_virtual_drives_arm_by_themselves(arm, tmp_path):
    def never(joints):
        raise AssertionError("arming was asked for")

    assert run(arm, tmp_path / "arm.mcap", arm=never).ending is Ending.COMPLETE


def test_real_drives_are_not_moved_unless_armed(arm, tmp_path):
    arm.real_drives = True
    asked = []
    with pytest.raises(NotArmed, match="joint1"):
        run(arm, tmp_path / "arm.mcap", arm=lambda joints: bool(asked.append(joints)))
    assert asked == [tuple(arm.modes)]
    assert arm.log == []
    assert not (tmp_path / "arm.mcap").exists()


def test_without_an_arm_function_real_drives_stay_where_they_are(arm, tmp_path):
    arm.real_drives = True
    with pytest.raises(NotArmed):
        run(arm, tmp_path / "arm.mcap")
    assert arm.log == []


def stop_while(phase, stop, act=None):
    def on_progress(progress):
        if progress.phase is phase and progress.dwells == 1:
            (act or stop.set)()

    return on_progress


def test_a_stop_in_the_middle_of_a_dwell_ends_safely(arm, tmp_path):
    stop = Stop()
    on_progress = stop_while(Phase.DWELLING, stop)
    summary = run(arm, tmp_path / "arm.mcap", stop=stop, on_progress=on_progress)
    assert summary.ending is Ending.STOPPED
    assert len(summary.dwells) == 1
    assert set(arm.modes.values()) == {Mode.OFF}
    recording = read_recording(tmp_path / "arm.mcap")
    assert len(recording.dwells) == 1
    assert "stopped" in recording.marks[-1].text


def test_ctrl_c_in_the_middle_of_a_dwell_ends_safely(arm, tmp_path):
    stop = Stop()
    before = signal.getsignal(signal.SIGINT)
    on_progress = stop_while(Phase.DWELLING, stop, lambda: os.kill(os.getpid(), signal.SIGINT))
    summary = run(arm, tmp_path / "arm.mcap", stop=stop, on_progress=on_progress)
    assert summary.ending is Ending.STOPPED
    assert set(arm.modes.values()) == {Mode.OFF}
    assert len(read_recording(tmp_path / "arm.mcap").dwells) == 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_stop_before_the_recording_began_writes_nothing(arm, tmp_path):
    stop = Stop()
    stop.set()
    with pytest.raises(StopRequested):
        run(arm, tmp_path / "arm.mcap", stop=stop)
    assert not (tmp_path / "arm.mcap").exists()


def test_a_drive_fault_ends_the_session_and_names_joint_and_code(arm, tmp_path):
    arm.on_sample = lambda seconds: (
        seconds > 3.0 and arm.log[-1][1] is not Mode.OFF and arm.fault("joint3")
    )
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.FAILED
    assert "joint3" in summary.why
    assert "0x8611" in summary.why
    assert {mode for _, mode, _ in arm.log[-7:]} == {Mode.OFF}
    assert summary.dwells
    assert len(read_recording(tmp_path / "arm.mcap").dwells) == len(summary.dwells)


def test_a_drive_that_switches_itself_off_ends_the_session(arm, tmp_path):
    def restart(seconds):
        if seconds > 3.0:
            arm.modes["joint5"] = Mode.OFF

    arm.on_sample = restart
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.FAILED
    assert "joint5" in summary.why


def test_a_drive_that_does_not_answer_any_more_does_not_keep_the_others_on(arm, tmp_path):
    def unplug(seconds):
        if seconds > 3.0:
            arm.link("arm-can").joints["joint5"].broken = True

    arm.on_sample = unplug
    summary = run(arm, tmp_path / "arm.mcap")
    assert {joint for joint, mode in arm.modes.items() if mode is not Mode.OFF} == {"joint5"}
    assert [fault.source for fault in summary.faults if fault.kind == "not-safe"] == ["joint5"]


def test_a_drive_that_answers_late_is_told_again(arm, tmp_path):
    late = iter([2.0, 4.0])
    due = next(late)

    def drop_answers(seconds):
        nonlocal due
        if seconds > due:
            arm.link("arm-can").joints["joint5"].unanswered = 2
            due = next(late, 1e9)

    arm.on_sample = drop_answers
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.COMPLETE, summary.why
    assert [(fault.source, fault.kind) for fault in summary.faults] == [("joint5", "no-answer")] * 4


@pytest.mark.parametrize("error", [LinkBroken("unplugged"), ValueError("a bug")])
def test_a_link_that_breaks_ends_the_session_and_is_named(arm, tmp_path, error):
    arm.link("arm-wrist").break_at_s = 3.0
    arm.link("arm-wrist").break_with = error
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.FAILED
    assert "arm-wrist" in summary.why
    assert str(error) in summary.why
    assert summary.error.__cause__ is error
    assert set(arm.modes.values()) == {Mode.OFF}
    recording = read_recording(tmp_path / "arm.mcap")
    assert "link-failed" in {fault.kind for fault in recording.faults}


def test_a_joint_that_does_not_move_is_a_fault_and_then_a_failure(arm, tmp_path):
    arm.stuck = {"joint5"}
    options = CaptureOptions(still_timeout_s=1.0, skipped_stops=2)
    summary = run(arm, tmp_path / "arm.mcap", options=options)
    assert summary.ending is Ending.FAILED
    assert "joint5" in summary.why
    assert [fault.kind for fault in summary.faults] == ["skipped", "skipped"]


def test_a_mechanism_that_swings_is_waited_for(arm, tmp_path):
    arm.values = lambda seconds: {"q1": 0.1 * (seconds % 0.5) if seconds < 6.0 else 0.0}
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.COMPLETE
    assert summary.dwells[0].start_ns / 1e9 - 1_700_000_000 > 6.0


def test_losses_are_accounted_for_in_file_and_summary(arm, tmp_path):
    arm.link("arm-wrist").drop_every = 10
    summary = run(arm, tmp_path / "arm.mcap")
    recording = read_recording(tmp_path / "arm.mcap")
    assert set(summary.ledger) == {channel.name for channel in arm.rig.channels}
    for name, entry in summary.ledger.items():
        assert entry.unaccounted == 0
        assert entry.received == len(recording.readings[name].raw)
        assert recording.ledger[name].unaccounted == 0
    assert summary.ledger["q6"].dropped_by_device > 10
    assert summary.ledger["q1"].dropped_by_device == 0


def test_progress_comes_five_times_a_second_with_rates_and_what_is_next(arm, tmp_path):
    seen = []
    run(arm, tmp_path / "arm.mcap", on_progress=seen.append)
    assert {Phase.MOVING, Phase.SETTLING, Phase.DWELLING} <= {p.phase for p in seen}
    gaps = [b.elapsed_s - a.elapsed_s for a, b in pairwise(seen)]
    assert max(gaps) < 0.3
    assert seen[-1].phase is Phase.STOPPING
    late = seen[-2]
    assert late.stops == len(visits(arm.rig.plan))
    assert late.stop == late.stops
    assert {c.name: round(c.rate_hz) for c in late.channels}["q1"] == pytest.approx(100, abs=3)


def test_readings_that_the_file_cannot_take_in_time_are_counted(arm, tmp_path):
    options = CaptureOptions(queue_capacity=3)
    summary = run(arm, tmp_path / "arm.mcap", options=options)
    recording = read_recording(tmp_path / "arm.mcap")
    assert sum(entry.dropped_by_host for entry in summary.ledger.values()) > 0
    for name, entry in summary.ledger.items():
        received = len(recording.readings[name].raw) if name in recording.readings else 0
        assert entry.unaccounted == 0
        assert entry.received == received
    assert "overflow" in {fault.kind for fault in recording.faults}


def test_a_disk_that_fails_ends_the_session_and_the_drives_are_off(arm, tmp_path, monkeypatch):
    class FullDisk(Writer):
        def write(self, event):
            if isinstance(event, Dwell):
                raise RecordingError("cannot write to the recording: no space left on device")
            super().write(event)

    monkeypatch.setattr("daq.session.Writer", FullDisk)
    summary = run(arm, tmp_path / "arm.mcap")
    assert summary.ending is Ending.FAILED
    assert "no space left" in summary.why
    assert set(arm.modes.values()) == {Mode.OFF}
    assert len(read_recording(tmp_path / "arm.mcap").readings["q1"].raw) > 100


def test_a_plan_given_in_place_of_the_rigs_is_executed(arm, tmp_path):
    plan = arm.rig.plan.model_copy(update={"poses": 2})
    summary = run(arm, tmp_path / "arm.mcap", plan_override=plan)
    assert summary.poses == 2
    assert read_recording(tmp_path / "arm.mcap").rig_toml == arm.toml


def test_a_progress_display_that_fails_is_no_reason_to_leave_drives_on(arm, tmp_path):
    def broken(progress):
        if progress.dwells == 1:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(arm, tmp_path / "arm.mcap", on_progress=broken)
    assert set(arm.modes.values()) == {Mode.OFF}
    assert len(read_recording(tmp_path / "arm.mcap").dwells) == 1


def test_a_rig_text_that_is_no_rig_leaves_nothing_running(arm, tmp_path):
    arm.toml = "not a rig"
    with pytest.raises(RigError):
        run(arm, tmp_path / "arm.mcap")
    assert not (tmp_path / "arm.mcap").exists()


def test_who_recorded_it_is_in_the_file(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap", operator="A. Person", notes="first light")
    session = read_recording(tmp_path / "arm.mcap").session
    assert (session.operator, session.notes) == ("A. Person", "first light")
    assert session.session_id
