"""Benches on which every link must keep its promises, and how the tests follow one.

``virtual``: the virtual devices on real ports in a thread; ``loopback``: the same in memory and by
virtual time; ``hardware``: the rig files that ``LOOPCAL_HARDWARE`` names.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers import Clock, Link, Losses
from recordings.events import Event, Reading
from recordings.faults import ENDED_BY, FaultKind
from recordings.rig import Rig, load_rig
from sim_devices.in_memory import MemoryBench
from sim_devices.running import running
from sim_devices.virtual_time import VirtualClock
from tests.drivers.families import FAMILIES
from tests.drivers.patience import PATIENCE_S

LATE = (
    FaultKind.LOSING,
    FaultKind.SILENT,
    FaultKind.LATE,
    FaultKind.STUCK,
    FaultKind.EMERGENCY,
)
BUSY = {*LATE, *(ENDED_BY[kind] for kind in LATE)}
"""What may be said where the computer is busy: devices that are programs are late, and miss their master."""

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
    *(pytest.param(in_memory, name, id=f"loopback-{name}") for name in FAMILIES),
]
HARDWARE = [
    pytest.param(on_hardware, path, id=f"hardware-{path}", marks=pytest.mark.hardware)
    for path in os.environ.get("LOOPCAL_HARDWARE", "").split(":")
    if path
]


def benches(*, hardware: bool) -> pytest.MarkDecorator:
    made = [
        pytest.param(param.values, id=param.id, marks=param.marks)
        for param in (*VIRTUAL, *(HARDWARE if hardware else ()))
    ]
    return pytest.mark.parametrize("bench", made, indirect=True)


def pump(
    link: Link, until: Callable[[list[Event]], bool], clock: Clock | None = None
) -> list[Event]:
    """What comes until ``until`` holds; fails after `PATIENCE_S` of real time."""
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
