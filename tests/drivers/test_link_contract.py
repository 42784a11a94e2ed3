"""What every link promises (`drivers.link.Link`), for every family, on every bench (`contract.py`).

Real devices are tried where the environment variable ``LOOPCAL_HARDWARE`` names a rig file (or
several, separated by ``:``)::

    LOOPCAL_HARDWARE=bench.toml pytest -m hardware tests/drivers/test_link_contract.py

On hardware nothing is moved and nothing is unplugged: drives are asked, and not commanded.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from drivers import (
    BadCommand,
    DeviceRefused,
    JointDrive,
    Link,
    LinkClosed,
    PortNotFound,
    make_links,
)
from recordings.events import Event, Fault, Mode, ModeCommand, ModeReport, Reading
from recordings.faults import FaultKind
from recordings.rig import parse_rig
from sim_devices.in_memory import MemoryBench
from sim_devices.virtual_time import VirtualClock
from tests.drivers.contract import (
    BUSY,
    CENTRE,
    VIRTUAL,
    Bench,
    NoisyPlant,
    assert_balanced,
    benches,
    enough,
    on_real_ports,
    pump,
    readings,
)
from tests.drivers.families import FAMILIES, HZ
from tests.drivers.patience import PATIENCE_S

SECOND = 1_000_000_000


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
        began_ns = bench.clock.now_ns()
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
            assert began_ns <= times[0] <= times[-1] <= bench.clock.now_ns()
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
        assert [e for e in events if isinstance(e, Fault) and e.kind not in BUSY] == []


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
        assert ended.wait(PATIENCE_S)
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


ATTEMPTS = 5
"""On a computer that stands still for a second, drives trip by their watchdogs, as they should."""


def walk_through_its_modes(drive: JointDrive) -> None:
    for mode in (Mode.FREE, Mode.POSITION, Mode.TORQUE, Mode.FREE, Mode.OFF):
        drive.set_mode(mode)
        shown = drive.report()
        if shown.mode is Mode.FAULT:
            raise DeviceRefused(f"it has tripped in {mode}")
        assert (shown.joint, shown.error_code) == (drive.joint, 0)
        # Torque at zero and a free joint are one thing to CiA 402.
        assert shown.mode in ({mode, Mode.FREE} if mode is Mode.TORQUE else {mode})
    drive.set_mode(Mode.POSITION)
    drive.move_to(CENTRE["q1"] + 50)
    with pytest.raises(BadCommand, match="expected TORQUE"):
        drive.set_torque(5)
    with pytest.raises(BadCommand):
        drive.set_mode(Mode.FAULT)
    drive.set_mode(Mode.OFF)


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
            for attempt in range(ATTEMPTS):
                try:
                    walk_through_its_modes(drive)
                except DeviceRefused:
                    if attempt == ATTEMPTS - 1:
                        raise
                    drive.set_mode(Mode.OFF)
                else:
                    break
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
