"""The drivers against the virtual devices, which share no codec with them, over real ports."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers import DeviceRefused, JointDrive, Link, make_links
from recordings.events import Event, Fault, Mode, Reading
from recordings.rig import load_rig
from tests.child_process import child_process
from tests.drivers.contract import BUSY
from tests.drivers.patience import PATIENCE_S


class MonotonicClock:
    """Real time, not anchored to anything."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


pytestmark = pytest.mark.wires

BENCH = """
import json, sys
from recordings.rig import load_rig
from sim_devices.bench import run_bench, stop_on_signals
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant

rig = load_rig("arm")
with stop_on_signals() as stop:
    run_bench(rig, make_plant(make_nature(rig, seed=3)), stop=stop, ports=json.loads(sys.argv[1]),
              ready=lambda addresses: print("ready", flush=True))
"""


@pytest.fixture(scope="module")
def ports(tmp_path_factory) -> Iterator[dict[str, str]]:
    """The virtual arm in a process of its own; paths by port name."""
    folder = tmp_path_factory.mktemp("arm")
    paths = {port.name: str(folder / port.name) for port in load_rig("arm").ports}
    command = [sys.executable, "-c", BENCH, json.dumps(paths)]
    with child_process(command) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield paths


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The far end is a process of its own, which a busy computer may hold up."""
    monkeypatch.setattr("drivers.canopen.sdo.SDO_TIMEOUT_S", PATIENCE_S)


@pytest.fixture
def links(request: pytest.FixtureRequest, ports) -> Iterator[tuple[Link, ...]]:
    """Links to the arm; a test can give options of its drives."""
    rig = load_rig("arm")
    more = getattr(request, "param", {})
    devices = tuple(
        device.model_copy(update={"options": {**device.options, **more}})
        if device.driver == "canopen-joint"
        else device
        for device in rig.devices
    )
    rig = rig.model_copy(update={"devices": devices})
    links = make_links(rig, MonotonicClock(), ports)
    for link in links:
        link.open()
    yield links
    for link in links:
        link.close()


@contextmanager
def pumped(link: Link) -> Iterator[list[Event]]:
    """Pumps ``link`` in a thread; what came is complete after the block."""
    events: list[Event] = []
    stop = threading.Event()

    def pump() -> None:
        while not stop.is_set():
            events.extend(link.pump(0.02))

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield events
    finally:
        stop.set()
        thread.join()
        link.stop()
        events.extend(link.pump(0.0))


def wait_until(holds) -> None:
    """Wait for the far end, looking every few milliseconds."""
    pause = threading.Event()
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, "it did not come about"
        pause.wait(0.005)


def test_every_device_answers_and_says_that_it_is_virtual(links):
    statuses = [status for link in links for status in link.check()]
    assert len(statuses) == 13
    assert all(s.answers and s.virtual and not s.problem for s in statuses), statuses
    assert {c for s in statuses for c in s.channels} == {f"q{n}" for n in range(1, 8)}


@pytest.mark.parametrize("number", [0, 1])
def test_readings_come_and_every_one_is_accounted_for(links, number):
    link = links[number]
    link.start(100.0)
    with pumped(link) as events:
        wait_until(lambda: sum(isinstance(e, Reading) for e in events) > 200)
    assert [e for e in events if isinstance(e, Fault) and e.kind not in BUSY] == []
    for name, losses in link.losses().items():
        readings = [e for e in events if isinstance(e, Reading) and e.channel == name]
        missing = losses.expected - len(readings)
        assert missing == losses.dropped_by_device + losses.lost_in_gaps
        sequence = [r.sequence for r in readings]
        assert sequence == sorted(set(sequence))


@pytest.mark.parametrize("links", [{"heartbeat_timeout_s": 60.0}], indirect=True)
def test_a_joint_follows_its_target_and_goes_free_again(links):
    can = links[0]
    drive = can.joints["joint2"]
    can.start(100.0)
    # However long a busy machine takes: the session would vouch for as long as it runs.
    drive.vouch(time.monotonic_ns() + 100 * 1_000_000_000)
    with pumped(can) as events:
        drive.set_mode(Mode.POSITION)
        assert drive.report().mode is Mode.POSITION
        wait_until(lambda: any(isinstance(e, Reading) and e.channel == "q2" for e in events))
        here = next(e.raw for e in events if isinstance(e, Reading) and e.channel == "q2")
        drive.move_to(here + 2000)

        def arrived() -> bool:
            last = next(e for e in reversed(events) if isinstance(e, Reading) and e.channel == "q2")
            return abs(last.raw - here - 2000) < 50

        wait_until(arrived)
        drive.set_mode(Mode.FREE)
        assert drive.report().mode is Mode.FREE
        drive.set_mode(Mode.OFF)
        assert drive.report().mode is Mode.OFF


def test_a_drive_that_misses_its_master_falls_into_fault_and_can_be_acknowledged(links):
    can = links[0]
    drive = can.joints["joint4"]
    wait_until(lambda: is_free(drive))
    # Nobody vouches for it: the link that is served sends no heartbeat.
    with pumped(can) as events:
        wait_until(lambda: drive.report().mode is Mode.FAULT)
        assert drive.report().error_code == 0x8130
        wait_until(lambda: any("0x8130" in e.text for e in events if isinstance(e, Fault)))
        drive.vouch(time.monotonic_ns() + 60_000_000_000)
        wait_until(lambda: acknowledged(drive))


def is_free(drive: JointDrive) -> bool:
    """Whether it could be set free; on a computer that stands still it may trip on the way."""
    try:
        drive.set_mode(Mode.FREE)
    except DeviceRefused:
        drive.set_mode(Mode.OFF)
        return False
    return True


def acknowledged(drive: JointDrive) -> bool:
    drive.set_mode(Mode.OFF)
    return drive.report().mode is Mode.OFF
