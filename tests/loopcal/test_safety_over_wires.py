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
from recordings.rig import parse_rig, rig_text
from tests.child_process import child_process

pytestmark = pytest.mark.wires

TEXT = rig_text("arm")[0] + "\n[interlocks]\nsilence_s = 2\n"
"""The arm, patient with a busy computer."""
RIG = parse_rig(TEXT)
PLAN = RIG.plan.model_copy(update={"sample": 25.0})
JOINTS = tuple(device.joint for device in RIG.devices if device.joint is not None)
WATCHDOG_S = 1.0  # heartbeat_timeout_s of the bundled arm's drives
BUSY_S = 8.0  # what a busy computer may add
HEARTBEAT_LOST = 0x8130
NOT_SUPERVISED = ("held up", "0x8130", "FAULT")  # whatever is noticed first
PATIENCE_S = 60.0

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
from recordings.rig import parse_rig

text = sys.stdin.read()
rig, clock = parse_rig(text), HostClock()
seen = set()
def on_progress(progress):
    if progress.state not in seen:
        seen.add(progress.state)
        print(progress.state.name, flush=True)
summary = capture(
    rig, text, sys.argv[2], clock=clock, on_progress=on_progress,
    plan_override=rig.plan.model_copy(update={"sample": 25.0}),
    links=make_links(rig, clock, json.loads(sys.argv[1])),
)
print(summary.why, flush=True)
"""


class Bench:
    """Virtual devices of the arm in a process of their own, and what their drives do."""

    def __init__(self, ports: dict[str, str], process: subprocess.Popen[str]) -> None:
        self.ports = ports
        self._process = process
        self._modes = dict.fromkeys(JOINTS, "off")
        self._changed = threading.Condition()
        self._ready = False
        self._reader = threading.Thread(target=self._read, daemon=True)
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
        self._reader.join(PATIENCE_S)


def off(modes) -> bool:
    return set(modes.values()) == {"off"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("ports")
    ports = {port.name: str(folder / port.name) for port in RIG.ports}
    command = [sys.executable, "-c", BENCH, json.dumps(ports)]
    with child_process(command, stdin=subprocess.PIPE) as process:
        bench = Bench(ports, process)
        yield bench
        bench.close()


@pytest.fixture(autouse=True)
def _begins_well(bench: Bench) -> None:
    bench.wait_until(off)


@contextmanager
def capturing(bench: Bench, folder: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A capture in a process of its own, which is moving the arm now, and the file that it writes.

    A computer that stands still for a second ends a session before its time: then another is begun.
    """
    for attempt in range(8):
        path = folder / f"arm-{attempt}.mcap"
        command = [sys.executable, "-c", CAPTURE, json.dumps(bench.ports), str(path)]
        pipe = subprocess.PIPE
        with child_process(command, stdin=pipe) as process:
            if _moves(process):
                yield process, path
                process.kill()
                return
            process.kill()
        bench.wait_until(off)
    pytest.fail("no session came so far that the arm moved")


def _moves(process: subprocess.Popen[str]) -> bool:
    """Hands the rig over; whether the session comes so far that it moves the arm."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(TEXT)
    process.stdin.close()
    process.stdin = None
    return any(
        line.strip() == SessionState.MOVING.name for line in iter(process.stdout.readline, "")
    )


def until(holds, session):
    """``session``, given its number, again until ``holds`` of its summary: a computer that stands
    still for a second ends a session before what the test is about could happen."""
    for attempt in range(8):
        summary = session(attempt)
        if holds(summary):
            break
    return summary


def run(bench: Bench, path: Path, on_progress=lambda progress: None, arming_s=60.0, **more):
    """A capture in this process."""
    clock = HostClock()
    return capture(
        RIG,
        TEXT,
        path,
        links=make_links(RIG, clock, bench.ports),
        clock=clock,
        on_progress=on_progress,
        plan_override=PLAN,
        arming=Arming(clock, arming_s),
        **more,
    )


def while_moving(act):
    """Do ``act`` once, when the first dwell is recorded and the drives move again; and what came of it."""
    done = []

    def on_progress(progress):
        if progress.state is SessionState.MOVING and progress.dwells >= 1 and not done:
            done.append(act())

    return on_progress, done


def test_killed_in_motion_the_drives_switch_themselves_off(bench: Bench, tmp_path: Path) -> None:
    with capturing(bench, tmp_path) as (process, _):
        assert not off(bench.modes)
        process.kill()
        process.wait()
        took_s = bench.wait_until(off)
    assert took_s < WATCHDOG_S + BUSY_S
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
    with capturing(bench, tmp_path) as (process, path):
        os.kill(process.pid, signal.SIGSTOP)
        assert bench.wait_until(off) < WATCHDOG_S + BUSY_S
        os.kill(process.pid, signal.SIGCONT)
        rest, _ = process.communicate(timeout=PATIENCE_S)
    assert any(words in rest for words in NOT_SUPERVISED)
    assert off(bench.modes)
    safe = [c.cause for c in read_recording(path).states if c.after is SessionState.SAFE]
    assert any(words in safe[0] for words in NOT_SUPERVISED)


def test_a_session_that_hangs_while_its_links_live_on_is_as_good_as_dead(
    bench: Bench, tmp_path: Path
) -> None:
    act, tripped = while_moving(lambda: bench.wait_until(off))
    summary = until(
        lambda _: tripped, lambda number: run(bench, tmp_path / f"arm-{number}.mcap", act)
    )
    assert tripped[0] < WATCHDOG_S + BUSY_S
    assert summary.ending is Ending.FAILED
    assert any(words in summary.why for words in NOT_SUPERVISED)


@pytest.mark.parametrize("lost", ["drive3", "encoder3", "arm-can"])
def test_what_is_lost_in_motion_switches_all_drives_off(
    bench: Bench, tmp_path: Path, lost: str
) -> None:
    act, done = while_moving(lambda: bench.inject(f"unplug {lost}"))
    summary = until(lambda _: done, lambda number: run(bench, tmp_path / f"arm-{number}.mcap", act))
    bench.wait_until(off)
    bench.inject(f"end unplug {lost}")
    assert done
    assert summary.ending is Ending.FAILED
    assert SessionState.SAFE in {change.after for change in summary.states}
    assert read_recording(summary.path).states == summary.states


def test_an_arming_that_nobody_renews_ends_the_session(bench: Bench, tmp_path: Path) -> None:
    armed = {"arming_s": 3.0, "arm_virtual": True, "mobility": mobility_of(RIG)}
    summary = until(
        lambda summary: not any(words in summary.why for words in NOT_SUPERVISED),
        lambda number: run(bench, tmp_path / f"arm-{number}.mcap", **armed),
    )
    assert summary.ending is Ending.FAILED
    assert "nobody renewed it for 3 s" in summary.why
    assert off(bench.modes)
    states = read_recording(summary.path).states
    assert states == summary.states
    assert states[-2].after is SessionState.SAFE
    assert "nobody renewed" in states[-2].cause
