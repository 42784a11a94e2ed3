"""Cells of the matrix over real ports and in real time: the same faults, noticed as the same kinds.

What the virtual clock and memory leave out (the kernel's terminals, threads, the time that a
turn really takes) makes no difference to what is noticed and how it is accounted for. How soon, a
busy computer cannot say: that is the matrix's.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from drivers import Link, make_links
from drivers.detection import DETECTION, SAMPLE_HZ, Detected, Trouble
from recordings.events import Event, Fault, Reading
from recordings.faults import FaultKind, episodes
from sim_devices.running import RunningBench, running
from tests.faults.bench import Noise, rig_of

pytestmark = pytest.mark.wires

PATIENCE_S = 60.0

SCRIPTS = {
    "canopen-encoder": (
        (Trouble.SILENCE, "silence device"),
        (Trouble.RESTART, "restart device"),
        (Trouble.UNPLUG, "unplug port"),
        (Trouble.BUS_OFF, "bus-off port"),
    ),
    "modbus-adc": (
        (Trouble.FOREIGN, "foreign device"),
        (Trouble.CHECKSUM, "corrupt port 50 %"),
        (Trouble.UNPLUG, "unplug port"),
        (Trouble.SILENCE, "silence device"),
    ),
    "modbus-adc over TCP": (
        (Trouble.FOREIGN, "foreign device"),
        (Trouble.UNPLUG, "unplug port"),
    ),
    "cobs-adc": (
        (Trouble.CHECKSUM, "corrupt port 50 %"),
        (Trouble.UNPLUG, "unplug port"),
    ),
}


class Monotonic:
    """Real time, anchored to nothing."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


class Session:
    """A link that is pumped, and what it has given since it was started."""

    def __init__(self, link: Link, bench: RunningBench) -> None:
        self.events: list[Event] = []
        self._link = link
        self._bench = bench

    def pump(self, until: Callable[[list[Event]], bool]) -> None:
        """Pump until ``until`` holds for what comes from now on."""
        came: list[Event] = []
        deadline = time.monotonic() + PATIENCE_S
        while not until(came):
            assert time.monotonic() < deadline, [e for e in self.events if isinstance(e, Fault)]
            came += (new := self._link.pump(0.02))
            self.events += new

    def suffer(self, line: str, kinds: tuple[FaultKind, ...]) -> None:
        """Let a fault be until it is noticed as one of ``kinds``, and then until all is well again."""
        self._bench.faults.inject(line)
        self.pump(lambda came: any(isinstance(e, Fault) and e.kind in kinds for e in came))
        verb, target = line.split()[:2]
        if verb != "restart":
            self._bench.faults.inject(f"end {verb} {target}")
        self.pump(lambda came: self._is_well() and any(isinstance(e, Reading) for e in came))

    def _is_well(self) -> bool:
        faults = (event for event in self.events if isinstance(event, Fault))
        return all(episode.end_ns is not None for episode in episodes(faults))


@pytest.mark.parametrize("name", SCRIPTS)
def test_faults_on_real_ports_are_noticed_and_accounted_for(name: str, loopcal_rig) -> None:
    bench = loopcal_rig(rig_of(name), plant=Noise())
    (link,) = make_links(bench.rig, Monotonic())
    link.open()
    try:
        link.start(SAMPLE_HZ)
        session = Session(link, bench)
        for trouble, line in SCRIPTS[name]:
            promise = DETECTION[name][trouble]
            assert isinstance(promise, Detected)
            session.suffer(line, promise.kinds)
        link.stop()
        events = [*session.events, *link.pump(0.0)]
        losses = link.losses()["q"]
    finally:
        link.close()
    received = sum(isinstance(event, Reading) for event in events)
    assert losses.expected - received == losses.dropped_by_device + losses.lost_in_gaps
    assert losses.lost_in_gaps > 0


def test_an_interface_that_has_error_frames_tells_bus_off_and_bus_errors_by_them(tmp_path) -> None:
    rig = rig_of("canopen-encoder")
    bus = {"interface": "virtual", "channel": f"faults-{tmp_path}"}
    rig = rig.model_copy(update={"ports": (rig.ports[0].model_copy(update=bus),)})
    with running(rig, Noise(), folder=None) as bench:
        (link,) = make_links(bench.rig, Monotonic())
        link.open()
        try:
            link.start(SAMPLE_HZ)
            session = Session(link, bench)
            session.suffer("corrupt port 50 %", (FaultKind.BUS_ERROR,))
            session.suffer("bus-off port", (FaultKind.BUS_OFF,))
        finally:
            link.close()
