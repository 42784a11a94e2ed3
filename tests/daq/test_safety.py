"""Sessions that must end safely, on a bench without wires: who is told what, and what is recorded."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from daq import (
    Arming,
    CaptureOptions,
    Ending,
    Phase,
    PlanNotPossible,
    Stop,
    capture,
)
from daq.mobility import Mobility
from drivers import DeviceSilent
from recordings.events import Dwell, Mode, SessionState
from recordings.reader import read_recording
from recordings.rig import parse_rig
from recordings.writer import Writer

SECOND = 1_000_000_000


def run(bench, path, **more):
    return capture(bench.rig, bench.toml, path, links=bench.links, clock=bench.clock, **more)


def with_interlocks(bench, text: str) -> None:
    interlocks = parse_rig(f"{bench.toml}\n[interlocks]\n{text}\n").interlocks
    bench.rig = bench.rig.model_copy(update={"interlocks": interlocks})


def all_off(bench) -> bool:
    return set(bench.modes.values()) == {Mode.OFF}


def assert_went_safe(bench, summary, path, words: str) -> None:
    """Failed for that reason, drives off, and the way to safe and its cause are in the file."""
    assert summary.ending is Ending.FAILED
    assert words in summary.why
    assert all_off(bench)
    recording = read_recording(path)
    assert recording.states == summary.states
    safe, idle = summary.states[-2:]
    assert (safe.after, idle.after) == (SessionState.SAFE, SessionState.IDLE)
    assert words in safe.cause
    moves = [c.time_ns for c in recording.mode_commands if c.mode is not Mode.OFF]
    assert max(moves) <= safe.time_ns


def test_a_good_session_goes_through_the_states_and_ends_through_safe(arm, tmp_path):
    summary = run(arm, tmp_path / "arm.mcap")
    after = [change.after for change in summary.states]
    stop = [SessionState.MOVING, SessionState.ARMED, SessionState.RECORDING, SessionState.ARMED]
    assert after[0] is SessionState.ARMED
    assert after[1:-2] == stop * len(summary.dwells)
    assert after[-2:] == [SessionState.SAFE, SessionState.IDLE]
    assert read_recording(tmp_path / "arm.mcap").states == summary.states
    assert all(change.cause for change in summary.states)


def test_targets_are_sent_only_while_moving(arm, tmp_path):
    run(arm, tmp_path / "arm.mcap")
    recording = read_recording(tmp_path / "arm.mcap")
    changes = recording.states
    for command in recording.mode_commands:
        if command.target_raw is not None:
            now = [c.after for c in changes if c.time_ns < command.time_ns][-1]
            assert now is SessionState.MOVING


def test_nobody_vouches_for_longer_than_a_moment_nor_in_the_safe_state(arm, tmp_path):
    ahead = []
    arm.on_sample = lambda seconds: ahead.extend(
        until - arm.clock.now_ns() for until in arm.vouched_ns.values()
    )
    summary = run(arm, tmp_path / "arm.mcap")
    assert set(arm.vouched_ns) == set(arm.modes)
    assert max(ahead) <= 0.3 * SECOND
    assert min(arm.vouched_ns.values()) <= summary.states[-2].time_ns + 0.3 * SECOND


def test_a_joint_seen_outside_its_travel_ends_the_session(arm, tmp_path):
    free = next(joint for joint in arm.modes if joint not in arm.rig.plan.drives)
    channel = arm.rig.sensed_by(free).name
    with_interlocks(arm, f'joint = [{{ name = "{free}", travel_deg = [-20, 20] }}]')
    arm.values = lambda seconds: {channel: 0.0 if seconds < 4.0 else 0.5}
    summary = run(arm, tmp_path / "arm.mcap")
    assert_went_safe(arm, summary, tmp_path / "arm.mcap", "outside its travel")
    (fault,) = [fault for fault in summary.faults if fault.kind == "interlock"]
    assert fault.source == free
    assert fault.time_ns - 1_700_000_004 * SECOND < 0.15 * SECOND


def test_a_joint_that_moves_too_fast_ends_the_session(arm, tmp_path):
    free = next(joint for joint in arm.modes if joint not in arm.rig.plan.drives)
    channel = arm.rig.sensed_by(free).name
    with_interlocks(arm, f'joint = [{{ name = "{free}", speed_deg_per_s = 60 }}]')
    arm.values = lambda seconds: {channel: max(0.0, 1.2 * (seconds - 4.0))}
    summary = run(arm, tmp_path / "arm.mcap")
    assert_went_safe(arm, summary, tmp_path / "arm.mcap", f"{free} moves with")


def test_a_plan_that_holds_too_many_joints_is_refused_before_a_port_is_touched(arm, tmp_path):
    with pytest.raises(PlanNotPossible, match="over-constrain a mechanism of mobility 1"):
        run(arm, tmp_path / "arm.mcap", mobility=Mobility(1))
    assert all(link.calls == [] for link in arm.links)


def test_a_drive_that_says_nothing_while_the_arm_stands_is_missed(arm, tmp_path, monkeypatch):
    drive = arm.link("arm-can").joints["joint6"]
    real = drive.report

    def report():
        if arm.clock.now_ns() > 1_700_000_004 * SECOND:
            raise DeviceSilent("node 22 gave no answer")
        return real()

    monkeypatch.setattr(drive, "report", report)
    summary = run(arm, tmp_path / "arm.mcap")
    assert_went_safe(
        arm, summary, tmp_path / "arm.mcap", "the drive of joint6 does not say how it is"
    )
    assert summary.duration_s < 4.0 + 2.5
    assert [f.source for f in summary.faults if f.kind == "no-answer"] == ["joint6"] * 2


def test_an_arming_that_is_not_renewed_ends_the_session(arm, tmp_path):
    arm.real_drives = True
    with_interlocks(arm, "arming_s = 4")
    summary = run(arm, tmp_path / "arm.mcap", arm=lambda joints: True)
    assert_went_safe(arm, summary, tmp_path / "arm.mcap", "nobody renewed it for 4 s")
    assert summary.duration_s == pytest.approx(4.0, abs=0.5)


def test_an_arming_that_is_renewed_lasts(arm, tmp_path):
    arm.real_drives = True
    arming = Arming(arm.clock, 4.0)
    summary = run(
        arm,
        tmp_path / "arm.mcap",
        arm=lambda joints: True,
        arming=arming,
        on_progress=lambda progress: arming.renew(),
    )
    assert summary.ending is Ending.COMPLETE
    assert summary.duration_s > 8.0


def test_virtual_drives_need_no_arming_that_lasts(arm, tmp_path):
    with_interlocks(arm, "arming_s = 1")
    assert run(arm, tmp_path / "arm.mcap").ending is Ending.COMPLETE


def test_nothing_is_led_on_blindly_and_a_joint_that_stays_unseen_ends_the_session(arm, tmp_path):
    def mute(seconds):
        arm.mute_channels = {"q3"} if 3.0 < seconds < 3.3 or seconds > 5.0 else set()

    arm.on_sample = mute
    summary = run(arm, tmp_path / "arm.mcap")
    assert_went_safe(arm, summary, tmp_path / "arm.mcap", "no reading of q3 for 1 s")
    start_ns = 1_700_000_000 * SECOND
    sent = [
        (command.time_ns - start_ns) / SECOND
        for command in read_recording(tmp_path / "arm.mcap").mode_commands
        if command.target_raw is not None
    ]
    assert not [seconds for seconds in sent if 3.15 < seconds < 3.3 or seconds > 5.15]


def test_a_session_that_was_held_up_does_not_go_on(arm, tmp_path):
    held = []

    def on_progress(progress):
        if progress.dwells == 1 and not held:
            held.append(True)
            arm.clock._now_ns += 2 * SECOND

    summary = run(arm, tmp_path / "arm.mcap", on_progress=on_progress)
    assert_went_safe(arm, summary, tmp_path / "arm.mcap", "held up for 2.0 s")


def test_a_drive_with_a_bug_does_not_keep_the_others_on(arm, tmp_path, monkeypatch):
    drive = arm.link("arm-can").joints[arm.rig.plan.drives[0]]
    real = drive.set_mode

    def set_mode(mode):
        if mode is Mode.OFF and arm.modes[drive.joint] is Mode.POSITION:
            raise ZeroDivisionError("a bug")
        real(mode)

    monkeypatch.setattr(drive, "set_mode", set_mode)
    summary = run(arm, tmp_path / "arm.mcap")
    assert {joint for joint, mode in arm.modes.items() if mode is not Mode.OFF} == {drive.joint}
    (fault,) = [fault for fault in summary.faults if fault.kind == "not-safe"]
    assert "ZeroDivisionError: a bug" in fault.text
    assert summary.states[-1].after is SessionState.SAFE


def test_a_drive_that_never_returns_stops_neither_the_others_nor_the_session(
    arm, tmp_path, monkeypatch
):
    monkeypatch.setattr("daq.drives.LONGEST_OFF_S", 0.3)
    released, hung = threading.Event(), threading.Event()

    def move_to(target_raw):
        hung.set()
        released.wait(60.0)

    joint = arm.rig.plan.drives[0]
    drive = arm.link("arm-can").joints[joint]
    monkeypatch.setattr(drive, "move_to", move_to)
    stop = Stop()
    summary = run(
        arm,
        tmp_path / "arm.mcap",
        stop=stop,
        on_progress=lambda progress: stop.set() if hung.is_set() else None,
    )
    assert summary.ending is Ending.STOPPED
    assert {name for name, mode in arm.modes.items() if mode is not Mode.OFF} == {joint}
    assert [fault.source for fault in summary.faults if fault.kind == "not-safe"] == [joint]
    released.set()
    for thread in threading.enumerate():
        if thread.name.startswith("loopcal-drive-"):
            thread.join(60.0)
    # What it was told first is over; that it be off is still the last that it hears.
    assert all_off(arm)


def test_two_signals_end_a_session_as_one_does(arm, tmp_path):
    def on_progress(progress):
        if progress.dwells == 1:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGHUP)

    summary = run(arm, tmp_path / "arm.mcap", on_progress=on_progress)
    assert summary.ending is Ending.STOPPED
    assert all_off(arm)
    assert len(read_recording(tmp_path / "arm.mcap").dwells) == 1


def test_a_session_under_nohup_outlives_its_terminal(arm, tmp_path):
    def on_progress(progress):
        if progress.dwells == 1:
            os.kill(os.getpid(), signal.SIGHUP)

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        summary = run(arm, tmp_path / "arm.mcap", on_progress=on_progress)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert summary.ending is Ending.COMPLETE


def test_a_disk_that_hangs_does_not_keep_drives_on(arm, tmp_path, monkeypatch):
    safe = threading.Event()

    class HangingDisk(Writer):
        def write(self, event):
            if isinstance(event, Dwell):
                assert safe.wait(60.0)
            super().write(event)

    monkeypatch.setattr("daq.session.Writer", HangingDisk)

    def watch():
        while not (len(arm.log) > 20 and all_off(arm)):
            threading.Event().wait(0.01)
        safe.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    summary = run(arm, tmp_path / "arm.mcap", options=CaptureOptions(queue_capacity=1_000_000))
    watcher.join(60.0)
    assert summary.ending is Ending.COMPLETE
    assert len(read_recording(tmp_path / "arm.mcap").dwells) == len(summary.dwells)


def test_a_session_by_hand_records_while_the_operator_moves(shoulder, tmp_path):
    shoulder.values = lambda seconds: {
        channel.name: (0.1 + 0.004 * (seconds // 2.0)) for channel in shoulder.rig.channels
    }
    summary = run(shoulder, tmp_path / "shoulder.mcap")
    after = [change.after.name for change in summary.states]
    assert after == ["ARMED", "RECORDING", "SAFE", "IDLE"]


def test_the_drives_are_off_before_the_end_is_shown(arm, tmp_path):
    shown = []

    def on_progress(progress):
        if progress.phase is Phase.STOPPING:
            shown.append(all_off(arm))
            raise OSError("the terminal is gone")

    with pytest.raises(OSError, match="terminal"):
        run(arm, tmp_path / "arm.mcap", on_progress=on_progress)
    assert shown == [True]
    assert len(read_recording(tmp_path / "arm.mcap").dwells) > 1


def test_a_channel_that_delivers_slowly_by_nature_is_not_silent(arm, tmp_path):
    """q3 comes three times a second, whatever the plan asks for."""
    last = []

    def slow(seconds):
        due = not last or seconds - last[-1] >= 0.33
        arm.mute_channels = set() if due else {"q3"}
        if due:
            last.append(seconds)

    for link in arm.links:
        if any(channel.name == "q3" for channel in link._channels):
            sample = link._sample

            def only(time_ns, sample=sample):
                slow((time_ns - 1_700_000_000 * SECOND) / SECOND)
                return sample(time_ns)

            link._sample = only
    options = CaptureOptions(still_timeout_s=1.0, skipped_stops=2)
    summary = run(arm, tmp_path / "arm.mcap", options=options)
    # A dwell needs more samples than that; but no interlock ends the session.
    assert "were skipped" in summary.why
    assert [change.after for change in summary.states].count(SessionState.MOVING) > 1
