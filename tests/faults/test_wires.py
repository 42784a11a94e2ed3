"""Cells of the matrix over real ports and in real time: the same faults, noticed as the same kinds.

What the virtual clock and memory leave out (the kernel's terminals, threads, the time that a
turn really takes) makes no difference to what is noticed and how it is accounted for.
"""

from __future__ import annotations

import time

import pytest

from drivers import make_links
from drivers.detection import DETECTION, SAMPLE_HZ, Detected, Trouble
from recordings.events import Fault, Reading
from recordings.faults import ENDED_BY, FaultKind, episodes
from sim_devices.running import running
from tests.faults.bench import Noise, rig_of

pytestmark = pytest.mark.wires

SLACK_S = 0.5
"""Of a busy machine, beside what is promised."""

SCRIPTS = {
    "canopen-encoder": (
        (0.5, Trouble.SILENCE, "silence device for 1 s"),
        (2.0, Trouble.RESTART, "restart device"),
        (3.0, Trouble.UNPLUG, "unplug port for 300 ms"),
        (4.5, Trouble.BUS_OFF, "bus-off port for 200 ms"),
    ),
    "modbus-adc": (
        (0.5, Trouble.FOREIGN, "foreign device for 500 ms"),
        (1.5, Trouble.CHECKSUM, "corrupt port 50 % for 300 ms"),
        (3.0, Trouble.UNPLUG, "unplug port for 300 ms"),
        (4.5, Trouble.SILENCE, "silence device for 300 ms"),
    ),
    "modbus-adc over TCP": (
        (0.5, Trouble.FOREIGN, "foreign device for 500 ms"),
        (1.5, Trouble.UNPLUG, "unplug port for 300 ms"),
    ),
    "cobs-adc": (
        (0.5, Trouble.CHECKSUM, "corrupt port 50 % for 300 ms"),
        (1.5, Trouble.UNPLUG, "unplug port for 300 ms"),
    ),
}
AFTER_S = 2.5


class Monotonic:
    """Real time, anchored to nothing."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


@pytest.mark.parametrize("name", SCRIPTS)
def test_faults_on_real_ports_are_noticed_and_accounted_for(name: str, loopcal_rig) -> None:
    script, clock = SCRIPTS[name], Monotonic()
    bench = loopcal_rig(rig_of(name), plant=Noise())
    (link,) = make_links(bench.rig, clock)
    link.open()
    try:
        link.start(SAMPLE_HZ)
        began_ns, events, to_come = clock.now_ns(), [], list(script)
        while (now_s := (clock.now_ns() - began_ns) / 1e9) < script[-1][0] + AFTER_S:
            if to_come and now_s >= to_come[0][0]:
                bench.faults.inject(to_come.pop(0)[2])
            events += link.pump(0.02)
        link.stop()
        events += link.pump(0.0)
        losses = link.losses()["q"]
    finally:
        link.close()

    faults = [event for event in events if isinstance(event, Fault)]
    for at_s, trouble, _ in script:
        promise = DETECTION[name][trouble]
        assert isinstance(promise, Detected)
        latest_s = at_s + promise.within_s + SLACK_S
        assert any(
            fault.kind in promise.kinds and at_s <= (fault.time_ns - began_ns) / 1e9 <= latest_s
            for fault in faults
        ), (trouble, [((f.time_ns - began_ns) / 1e9, f.kind) for f in faults])
    lasting = [e for e in episodes(faults) if e.kind in ENDED_BY and e.end_ns is None]
    assert lasting == []
    received = sum(isinstance(event, Reading) for event in events)
    assert losses.expected - received == losses.dropped_by_device + losses.lost_in_gaps
    assert losses.lost_in_gaps > 0
    assert received > 50


def test_an_interface_that_has_error_frames_tells_bus_off_and_bus_errors_by_them(tmp_path) -> None:
    rig, clock = rig_of("canopen-encoder"), Monotonic()
    bus = {"interface": "virtual", "channel": f"faults-{tmp_path}"}
    rig = rig.model_copy(update={"ports": (rig.ports[0].model_copy(update=bus),)})
    with running(rig, Noise(), folder=None) as bench:
        (link,) = make_links(bench.rig, clock)
        link.open()
        try:
            link.start(SAMPLE_HZ)
            began_ns, events = clock.now_ns(), []
            to_come = [(0.3, "corrupt port 50 % for 300 ms"), (1.0, "bus-off port for 200 ms")]
            while (now_s := (clock.now_ns() - began_ns) / 1e9) < 3.5:
                if to_come and now_s >= to_come[0][0]:
                    bench.faults.inject(to_come.pop(0)[1])
                events += link.pump(0.02)
        finally:
            link.close()
    found = episodes(event for event in events if isinstance(event, Fault))
    assert {FaultKind.BUS_ERROR, FaultKind.BUS_OFF} <= {each.kind for each in found}
    assert all(each.end_ns is not None for each in found), found
    assert isinstance(events[-1], Reading)
