"""However a session ends, the drives end off: seen by nature itself, behind drives in a process of their own.

What each drive makes of its joint is printed by the bench as it happens, so that no host has
to be alive to ask.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from daq import Arming, Ending, HostClock, capture
from drivers import make_links
from loopcal.loop_mobility import mobility_of
from recordings.events import Mode, SessionState
from recordings.reader import read_recording
from recordings.rig import load_rig, rig_text

pytestmark = pytest.mark.wires

RIG = load_rig("arm")
JOINTS = tuple(device.joint for device in RIG.devices if device.joint is not None)
WATCHDOG_S = 1.0  # heartbeat_timeout_s of the bundled arm's drives
HEARTBEAT_LOST = 0x8130
PATIENCE_S = 20.0

BENCH = """
import json, sys, threading
from recordings.rig import load_rig
from sim_devices.bench import run_bench, stop_on_signals
from sim_devices.faults import Injector
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant

class Told:
    def __init__(self, plant):
        self.plant = plant
        self.advance, self.sense, self.drive_fault = plant.advance, plant.sense, plant.drive_fault
        self.modes = {}
    def command(self, joint, mode, target_raw):
        self.plant.command(joint, mode, target_raw)
        if self.modes.get(joint) != mode:
            self.modes[joint] = mode
            print(json.dumps([joint, mode]), flush=True)

rig = load_rig("arm")
faults = Injector(rig)
threading.Thread(target=lambda: [faults.inject(line.strip()) for line in sys.stdin], daemon=True).start()
with stop_on_signals() as stop:
    run_bench(
        rig, Told(make_plant(make_nature(rig, seed=3))), stop=stop, faults=faults,
        ports=json.loads(sys.argv[1]),
        ready=lambda addresses: print(json.dumps(["", "ready"]), flush=True),
    )
"""

CAPTURE = """
import json, sys
from daq import HostClock, capture
from drivers import make_links
from recordings.rig import load_rig, rig_text

rig, clock = load_rig("arm"), HostClock()
seen = set()
def on_progress(progress):
    if progress.state not in seen:
        seen.add(progress.state)
        print(progress.state.name, flush=True)
summary = capture(
    rig, rig_text("arm")[0], sys.argv[2], clock=clock, on_progress=on_progress,
    links=make_links(rig, clock, json.loads(sys.argv[1])),
)
print(summary.why, flush=True)
"""


class Bench:
    """Virtual devices of the arm in a process of their own, and what their drives do."""

    def __init__(self, ports: dict[str, str]) -> None:
        self.ports = ports
        command = [sys.executable, "-c", BENCH, json.dumps(ports)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        self._modes = dict.fromkeys(JOINTS, "off")
        self._changed = threading.Condition()
        self._ready = False
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self.wait_until(lambda modes: self._ready)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            joint, mode = json.loads(line)
            with self._changed:
                if joint:
                    self._modes[joint] = mode
                self._ready = True
                self._changed.notify_all()

    @property
    def modes(self) -> dict[str, str]:
        with self._changed:
            return dict(self._modes)

    def wait_until(self, holds) -> float:
        """How long it took until ``holds`` of the modes of all drives [s]."""
        since = time.monotonic()
        with self._changed:
            assert self._changed.wait_for(lambda: holds(self._modes), PATIENCE_S), self._modes
        return time.monotonic() - since

    def inject(self, line: str) -> None:
        assert self._process.stdin is not None
        print(line, file=self._process.stdin, flush=True)

    def close(self) -> None:
        self._process.terminate()
        self._reader.join()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            pipe.close()


def off(modes) -> bool:
    return set(modes.values()) == {"off"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("ports")
    bench = Bench({port.name: str(folder / port.name) for port in RIG.ports})
    try:
        yield bench
    finally:
        bench.close()


@pytest.fixture(autouse=True)
def _begins_well(bench: Bench) -> None:
    bench.wait_until(off)


@contextmanager
def capturing(bench: Bench, path: Path) -> Iterator[subprocess.Popen[str]]:
    """A capture in a process of its own, which is moving the arm now."""
    command = [sys.executable, "-c", CAPTURE, json.dumps(bench.ports), str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            while process.stdout.readline().strip() != SessionState.MOVING.name:
                assert process.poll() is None
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def run(bench: Bench, path: Path, on_progress=lambda progress: None, **more):
    """A capture in this process."""
    clock = HostClock()
    links = make_links(RIG, clock, bench.ports)
    return capture(
        RIG, rig_text("arm")[0], path, links=links, clock=clock, on_progress=on_progress, **more
    )


def while_moving(act):
    """Do ``act`` once, when the first dwell is recorded and the drives move again."""
    done = []

    def on_progress(progress):
        if progress.state is SessionState.MOVING and progress.dwells >= 1 and not done:
            done.append(act())

    return on_progress


def test_killed_in_motion_the_drives_switch_themselves_off(bench: Bench, tmp_path: Path) -> None:
    with capturing(bench, tmp_path / "arm.mcap") as process:
        assert not off(bench.modes)
        process.kill()
        process.wait()
        took_s = bench.wait_until(off)
    assert took_s < WATCHDOG_S + 2.0
    clock = HostClock()
    links = make_links(RIG, clock, bench.ports)
    try:
        for link in links:
            link.open()
        reports = [drive.report() for link in links for drive in link.joints.values()]
    finally:
        for link in links:
            link.close()
    assert {report.mode for report in reports} == {Mode.FAULT}
    assert {report.error_code for report in reports} == {HEARTBEAT_LOST}


def test_suspended_in_motion_the_drives_switch_off_and_the_session_does_not_go_on(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "arm.mcap"
    with capturing(bench, path) as process:
        os.kill(process.pid, signal.SIGSTOP)
        assert bench.wait_until(off) < WATCHDOG_S + 2.0
        os.kill(process.pid, signal.SIGCONT)
        rest, _ = process.communicate(timeout=PATIENCE_S)
    assert "held up" in rest
    assert off(bench.modes)
    assert "held up" in read_recording(path).states[-2].cause


def test_a_session_that_hangs_while_its_links_live_on_is_as_good_as_dead(
    bench: Bench, tmp_path: Path
) -> None:
    tripped = []
    act = while_moving(lambda: tripped.append(bench.wait_until(off)))
    summary = run(bench, tmp_path / "arm.mcap", act)
    assert tripped[0] < WATCHDOG_S + 2.0
    assert summary.ending is Ending.FAILED
    assert "held up" in summary.why
    reports = read_recording(tmp_path / "arm.mcap").mode_reports
    assert HEARTBEAT_LOST in {report.error_code for report in reports}


@pytest.mark.parametrize("lost", ["drive3", "encoder3"])
def test_one_device_lost_in_motion_switches_all_drives_off(
    bench: Bench, tmp_path: Path, lost: str
) -> None:
    summary = run(
        bench,
        tmp_path / "arm.mcap",
        while_moving(lambda: bench.inject(f"unplug {lost} for 8 s")),
    )
    assert summary.ending is Ending.FAILED
    named = {"drive3": "joint3", "encoder3": "q3"}[lost]
    assert named in summary.why
    bench.wait_until(off)
    assert summary.states[-1].after is (
        SessionState.SAFE if lost == "drive3" else SessionState.IDLE
    )
    bench.inject(f"end unplug {lost}")


def test_an_arming_that_nobody_renews_ends_the_session(bench: Bench, tmp_path: Path) -> None:
    path, clock = tmp_path / "arm.mcap", HostClock()
    links = make_links(RIG, clock, bench.ports)
    summary = capture(
        RIG,
        rig_text("arm")[0],
        path,
        links=links,
        clock=clock,
        arming=Arming(clock, 2.0),
        arm_virtual=True,
        mobility=mobility_of(RIG),
    )
    assert summary.ending is Ending.FAILED
    assert "nobody renewed it for 2 s" in summary.why
    assert off(bench.modes)
    states = read_recording(path).states
    assert states == summary.states
    assert states[-2].after is SessionState.SAFE
    assert "nobody renewed" in states[-2].cause
