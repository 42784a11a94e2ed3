"""A host that is held up loses samples that it did not ask for; it draws no conclusion of its devices.

The host's own program stands still at random moments, for up to three seconds, while the devices
and what is between them go on: what they send waits to be read.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import pytest

from drivers import Link, make_links
from recordings.events import Event, Fault, Mode
from recordings.faults import FaultKind
from sim_devices.in_memory import MemoryBench
from sim_devices.virtual_time import VirtualClock
from tests.drivers.contract import NoisyPlant, assert_balanced
from tests.drivers.families import FAMILIES, HZ

LENGTHS_S = (0.15, 0.3, 0.7, 1.3, 3.0)
SEED = 1
HONEST = {FaultKind.LOSING, FaultKind.COMPLETE, FaultKind.EMERGENCY, FaultKind.EMERGENCY_OVER}
"""Samples that nobody asked for in time are lost, and a drive that misses its master says so."""


@contextmanager
def held_up(clock: VirtualClock, seed: int) -> Iterator[list[float]]:
    """Inside, some short waits of the host last very long; gives what is still to come of them."""
    chance, lengths_s = random.Random(seed), list(LENGTHS_S)
    chance.shuffle(lengths_s)
    sleep = time.sleep

    def sleep_too_long(seconds: float) -> None:
        sleep(seconds)
        if lengths_s and chance.random() < 0.01:
            clock.advance(lengths_s.pop())

    with patch.object(time, "sleep", sleep_too_long):
        yield lengths_s


def serve(name: str, link: Link, clock: VirtualClock, seconds: float) -> list[Event]:
    events: list[Event] = []
    until_s = clock.time_s + seconds
    while clock.time_s < until_s:
        for drive in link.joints.values():
            drive.vouch(2**62)
        # A Modbus link waits for its time on an event, which knows no virtual time.
        events += link.pump(0.0 if "modbus" in name else 0.02)
        time.sleep(0.001)
    return events


@pytest.mark.parametrize("name", FAMILIES)
def test_no_device_is_blamed_for_what_the_host_missed(name: str) -> None:
    clock = VirtualClock()
    bench = MemoryBench(FAMILIES[name].rig, NoisyPlant(), clock)
    with bench.running():
        (link,) = make_links(bench.rig, clock)
        link.open()
        assert all(status.answers for status in link.check())
        link.start(HZ)
        events = serve(name, link, clock, 1.2)
        with held_up(clock, SEED) as to_come:
            while to_come:
                events += serve(name, link, clock, 0.1)
        events += serve(name, link, clock, 1.2)
        link.stop()
        events += link.pump(0.0)
        losses = link.losses()
        link.close()
    blamed = [e for e in events if isinstance(e, Fault) and e.kind not in HONEST]
    assert blamed == []
    assert_balanced(losses, events)


@pytest.mark.parametrize("name", ["canopen", "dbc"])
def test_a_drive_obeys_a_host_that_is_held_up(name: str) -> None:
    clock = VirtualClock()
    bench = MemoryBench(FAMILIES[name].rig, NoisyPlant(), clock)
    with bench.running():
        (link,) = make_links(bench.rig, clock)
        link.open()
        link.start(HZ)
        (drive,) = link.joints.values()
        with held_up(clock, SEED) as to_come:
            while to_come:
                drive.vouch(2**62)
                drive.set_mode(Mode.OFF)
                assert drive.report().mode is Mode.OFF
                serve(name, link, clock, 0.1)
        link.close()
