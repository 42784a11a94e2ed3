"""What every link promises (`drivers.link.Link`), for every family of devices, on every bench.

Benches: ``virtual``, the virtual devices on real ports in a thread; ``loopback``, the same in memory
and by virtual time; and ``hardware``, real devices, where the environment variable
``LOOPCAL_HARDWARE`` names a rig file (or several, separated by ``:``)::

    LOOPCAL_HARDWARE=bench.toml pytest -m hardware tests/drivers/test_link_contract.py

On hardware nothing is moved and nothing is unplugged: drives are asked, and not commanded.
"""

from __future__ import annotations

import os
import random
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest

from drivers import (
    BadCommand,
    Clock,
    Link,
    LinkClosed,
    Losses,
    PortNotFound,
    make_links,
)
from recordings.events import Event, Fault, Mode, ModeCommand, ModeReport, Reading
from recordings.faults import FaultKind
from recordings.rig import Rig, load_rig, parse_rig
from sim_devices.in_memory import MemoryBench
from sim_devices.running import running
from sim_devices.virtual_time import VirtualClock
from tests.drivers.families import FAMILIES, HZ

SECOND = 1_000_000_000
PATIENCE_S = 10.0
CENTRE = {"q1": 4000, "q2": 7000}


class NoisyPlant:
    """Nature: joints that stand still where they are told, sensors with noise of their own."""

    def __init__(self) -> None:
        self._random = random.Random(7)
        self.commands: list[tuple[str, str, int]] = []

    def advance(self, time_s: float) -> None: ...

    def sense(self, channel: str) -> int:
        return CENTRE[channel] + self._random.randint(-3, 3)

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        self.commands.append((joint, mode, target_raw))

    def drive_fault(self, joint: str) -> int:
        return 0


class MonotonicClock:
    """Real time, not anchored to anything."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


@dataclass(frozen=True, slots=True)
class Bench:
    """A bench for the length of a test.

    Attributes:
        rig: the rig, with its ports where the bench is.
        clock: time of the links.
        virtual: whether the devices are ours: what they measure is known, and they may be moved.
        unplug: lets a port disappear and come back.
    """

    rig: Rig
    clock: Clock
    virtual: bool
    unplug: Callable[[str, float], None]


@contextmanager
def on_real_ports(family: str, folder: Path) -> Iterator[Bench]:
    with running(FAMILIES[family].rig, NoisyPlant(), folder) as bench:
        unplug = lambda port, s: bench.faults.inject(f"unplug {port} for {s} s")  # noqa: E731
        yield Bench(bench.rig, MonotonicClock(), True, unplug)


@contextmanager
def in_memory(family: str, folder: Path) -> Iterator[Bench]:
    clock = VirtualClock()
    bench = MemoryBench(FAMILIES[family].rig, NoisyPlant(), clock)
    with bench.running():
        unplug = lambda port, s: bench.faults.inject(f"unplug {port} for {s} s")  # noqa: E731
        yield Bench(bench.rig, clock, True, unplug)


@contextmanager
def on_hardware(path: str, folder: Path) -> Iterator[Bench]:
    yield Bench(load_rig(path), MonotonicClock(), False, lambda port, s: None)


VIRTUAL = [
    *(pytest.param(on_real_ports, name, id=f"virtual-{name}") for name in FAMILIES),
    # A TCP port is this computer's own on either bench.
    *(
        pytest.param(in_memory, name, id=f"loopback-{name}")
        for name in FAMILIES
        if not name.endswith("tcp")
    ),
]
HARDWARE = [
    pytest.param(on_hardware, path, id=f"hardware-{path}", marks=pytest.mark.hardware)
    for path in os.environ.get("LOOPCAL_HARDWARE", "").split(":")
    if path
]


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    kind, name = request.param
    with kind(name, tmp_path) as made:
        yield made


@pytest.fixture
def links(bench: Bench) -> Iterator[tuple[Link, ...]]:
    made = make_links(bench.rig, bench.clock)
    for link in made:
        link.open()
    yield made
    for link in made:
        link.close()


def benches(*, hardware: bool) -> pytest.MarkDecorator:
    made = [
        pytest.param(param.values, id=param.id, marks=param.marks)
        for param in (*VIRTUAL, *(HARDWARE if hardware else ()))
    ]
    return pytest.mark.parametrize("bench", made, indirect=True)


def pump(
    link: Link, until: Callable[[list[Event]], bool], clock: Clock | None = None
) -> list[Event]:
    """What comes until ``until`` holds; fails after ten seconds of real time."""
    events: list[Event] = []
    deadline = time.perf_counter() + PATIENCE_S
    while not until(events):
        assert time.perf_counter() < deadline, f"waited in vain; last: {events[-5:]}"
        for drive in link.joints.values():
            drive.vouch(2**62)
        if isinstance(clock, VirtualClock):
            events.extend(link.pump(0.0))
            clock.advance(0.005)
        else:
            events.extend(link.pump(0.02))
    return events


def readings(events: list[Event], channel: str) -> list[Reading]:
    return [e for e in events if isinstance(e, Reading) and e.channel == channel]


def enough(link: Link, count: int) -> Callable[[list[Event]], bool]:
    names = list(link.losses())
    return lambda events: all(len(readings(events, name)) >= count for name in names)


def assert_balanced(losses: Mapping[str, Losses], events: list[Event]) -> None:
    for name, each in losses.items():
        missing = each.expected - len(readings(events, name))
        assert missing == each.dropped_by_device + each.lost_in_gaps, name


@benches(hardware=True)
def test_every_device_and_channel_of_the_port_is_there(bench, links):
    statuses = [status for link in links for status in link.check()]
    assert {s.name for s in statuses} == {device.name for device in bench.rig.devices}
    assert all(status.answers and not status.problem for status in statuses), statuses
    channels = {channel.name for channel in bench.rig.channels}
    assert {name for status in statuses for name in status.channels} == channels
    assert {name for link in links for name in link.losses()} == channels


@benches(hardware=True)
def test_readings_come_in_order_and_every_one_is_accounted_for(bench, links):
    for link in links:
        link.check()
        link.start(HZ)
        events = pump(link, enough(link, 10), bench.clock)
        assert_balanced(link.losses(), events)
        events += pump(link, enough(link, 10), bench.clock)
        link.stop()
        events += link.pump(0.0)
        assert_balanced(link.losses(), events)
        for name in link.losses():
            came = readings(events, name)
            times = [reading.time_ns for reading in came]
            assert times == sorted(times)
            assert abs(times[-1] - bench.clock.now_ns()) < 5 * SECOND
            for field in ("sequence", "device_time_ns"):
                given = [getattr(r, field) for r in came if getattr(r, field) is not None]
                assert len(given) in (0, len(came))
                assert given == sorted(given), field


@benches(hardware=False)
def test_what_is_read_is_what_the_devices_measure(bench, links, request):
    family = FAMILIES[request.node.callspec.id.partition("-")[2]]
    for link in links:
        link.start(HZ)
        events = pump(link, enough(link, 20), bench.clock)
        for name in link.losses():
            came = readings(events, name)
            assert {abs(r.raw - CENTRE[name]) <= 3 for r in came} == {True}
            assert len({r.raw for r in came}) > 2
            if family.counted:
                assert all(b.sequence > a.sequence for a, b in pairwise(came))
            if family.timed:
                spans = came[-1].device_time_ns - came[0].device_time_ns
                assert spans > 0
        # A busy computer may lose readings, and says so; nothing else may be wrong.
        lossy = (FaultKind.LOSING, FaultKind.COMPLETE, FaultKind.SILENT, FaultKind.ANSWERING)
        assert [e for e in events if isinstance(e, Fault) and e.kind not in lossy] == []


@benches(hardware=True)
def test_a_stopped_link_delivers_no_more_and_can_start_again(bench, links):
    for link in links:
        link.stop()
        link.start(HZ)
        events = pump(link, enough(link, 3), bench.clock)
        link.stop()
        events += link.pump(0.0)
        before = link.losses()
        for _ in range(3):
            assert [e for e in link.pump(0.01) if isinstance(e, Reading)] == []
        assert link.losses() == before
        link.stop()
        link.start(HZ)
        events += pump(link, enough(link, 3), bench.clock)
        assert_balanced(link.losses(), events)


@benches(hardware=True)
def test_a_closed_link_says_so_and_opens_again(bench, links):
    for link in links:
        link.close()
        link.close()
        for use in (link.check, lambda link=link: link.pump(0.0), lambda link=link: link.start(HZ)):
            with pytest.raises(LinkClosed):
                use()
        link.open()
        link.start(HZ)
        pump(link, enough(link, 1), bench.clock)


@benches(hardware=True)
def test_closing_ends_a_pump_that_waits(bench, links, request):
    if isinstance(bench.clock, VirtualClock):
        return  # made for one thread
    for link in links:
        ended = threading.Event()

        def serve(link=link, ended=ended) -> None:
            try:
                while True:
                    link.pump(5.0)
            except LinkClosed:
                ended.set()

        thread = threading.Thread(target=serve)
        thread.start()
        link.close()
        assert ended.wait(2.0)
        thread.join()


@benches(hardware=False)
def test_a_port_that_is_not_there_is_named(bench, tmp_path):
    for port in bench.rig.ports:
        missing = "127.0.0.1:1" if port.kind == "tcp" else str(tmp_path / "nothing")
        others = [d.name for d in bench.rig.devices if d.port == port.name]
        assert others
        (link,) = make_links(bench.rig, bench.clock, {port.name: missing})
        with pytest.raises(PortNotFound, match=missing):
            link.open()


@benches(hardware=False)
def test_an_unplugged_port_is_reported_reopened_and_accounted_for(bench, links):
    for link in links:
        link.check()
        link.start(HZ)
        events = pump(link, enough(link, 5), bench.clock)
        bench.unplug(link.name, 0.3)
        kinds = [FaultKind.BROKEN, FaultKind.REOPENED]

        def back(came: list[Event], kinds=kinds) -> bool:
            return [e.kind for e in came if isinstance(e, Fault) and e.kind in kinds] == kinds

        events += pump(link, back, bench.clock)
        events += pump(link, enough(link, 5), bench.clock)
        link.stop()
        events += link.pump(0.0)
        losses = link.losses()
        assert_balanced(losses, events)
        for name, each in losses.items():
            assert each.lost_in_gaps + each.dropped_by_device >= 10, name
            assert each.gaps >= 1, name


def joints(links: tuple[Link, ...]) -> list[tuple[Link, str]]:
    return [(link, joint) for link in links for joint in link.joints]


DRIVEN = [p for p in VIRTUAL if p.values[1] in ("canopen", "dbc") and p.values[0] is on_real_ports]


@pytest.mark.parametrize("bench", [pytest.param(p.values, id=p.id) for p in DRIVEN], indirect=True)
def test_a_drive_obeys_confirms_and_refuses(bench, links):
    for link, joint in joints(links):
        drive = link.joints[joint]
        link.check()
        link.start(HZ)
        stop = threading.Event()

        def serve(link=link, stop=stop) -> None:
            while not stop.is_set():
                for each in link.joints.values():
                    each.vouch(bench.clock.now_ns() + SECOND)
                link.pump(0.02)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with pytest.raises(BadCommand, match="expected POSITION"):
                drive.move_to(5)
            for mode in (Mode.FREE, Mode.POSITION, Mode.TORQUE, Mode.FREE, Mode.OFF):
                drive.set_mode(mode)
                shown = drive.report()
                assert (shown.joint, shown.error_code) == (joint, 0)
                # Torque at zero and a free joint are one thing to CiA 402.
                expected = {mode, Mode.FREE} if mode is Mode.TORQUE else {mode}
                assert shown.mode in expected
            drive.set_mode(Mode.POSITION)
            drive.move_to(CENTRE["q1"] + 50)
            with pytest.raises(BadCommand, match="expected TORQUE"):
                drive.set_torque(5)
            with pytest.raises(BadCommand):
                drive.set_mode(Mode.FAULT)
            drive.set_mode(Mode.OFF)
        finally:
            stop.set()
            thread.join()


@pytest.mark.parametrize(
    "bench", [pytest.param(p.values, id=p.id) for p in VIRTUAL if p.values[1] == "listeners"],
    indirect=True,
)  # fmt: skip
def test_listeners_hear_another_controller_and_say_nothing(bench, links):
    (link,) = links
    link.start(HZ)
    wanted = {Mode.OFF, Mode.FREE, Mode.POSITION}

    def heard(events: list[Event]) -> bool:
        return all(
            {e.mode for e in events if isinstance(e, kind) and e.joint == joint} >= wanted
            for kind in (ModeCommand, ModeReport)
            for joint in ("joint1", "joint2")
        )

    events = pump(link, heard, bench.clock)
    moves = [e for e in events if isinstance(e, ModeCommand) and e.target_raw is not None]
    assert {e.joint for e in moves} == {"joint1", "joint2"}
    assert all(
        abs(e.target_raw - CENTRE["q1" if e.joint == "joint1" else "q2"]) < 300 for e in moves
    )
    assert all("another controller sent" in e.cause for e in moves)
    assert link.joints == {}


def test_the_adapters_time_is_device_time_where_the_device_has_none(tmp_path):
    family = FAMILIES["dbc"]
    stamped = family.text.replace(
        'channel = "/tmp/loop', 'adapter_time = true\nchannel = "/tmp/loop'
    )
    clock = VirtualClock()
    bench = MemoryBench(parse_rig(stamped), NoisyPlant(), clock)
    with bench.running():
        (link,) = make_links(bench.rig, clock)
        link.open()
        link.start(HZ)
        events = pump(link, enough(link, 20), clock)
        link.close()
    own, adapters = readings(events, "q1"), readings(events, "q2")
    assert all(r.device_time_ns is not None for r in (*own, *adapters))
    # The adapter counts milliseconds; the encoder of q2 has no clock, that of q1 keeps its own.
    spans = [b.device_time_ns - a.device_time_ns for a, b in pairwise(adapters)]
    assert {abs(span - 10_000_000) <= 5_000_000 for span in spans} == {True}
    assert all(r.device_time_ns % 1_000_000 == 0 for r in adapters)
