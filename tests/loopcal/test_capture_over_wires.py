"""Captures of both bundled rigs through real ports, against virtual devices in their own process."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from daq import CaptureSummary, Ending, HostClock, NotReady, capture
from drivers import make_links
from recordings.reader import read_recording
from recordings.rig import Rig, load_rig, parse_rig, rig_text, visits
from recordings.timing import DeviceTiming
from sim_devices.crystal import crystal_of
from tests.child_process import child_process

BENCH = """
import json, sys
from recordings.rig import load_rig
from sim_devices.bench import run_bench, stop_on_signals
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant

rig = load_rig(sys.argv[1])
with stop_on_signals() as stop:
    run_bench(
        rig,
        make_plant(make_nature(rig, seed=3)),
        stop=stop,
        ports=json.loads(sys.argv[2]),
        ready=lambda addresses: print("ready", flush=True),
    )
"""


@contextmanager
def bench(rig: str, ports: Mapping[str, str]) -> Iterator[None]:
    """Virtual devices of a bundled rig on ``ports``."""
    with child_process([sys.executable, "-c", BENCH, rig, json.dumps(ports)]) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield


def shortened(rig: Rig) -> Rig:
    """6 poses, of which 1 is visited again."""
    revisit = rig.plan.revisit.model_copy(update={"poses": 1, "visits": 2})
    plan = rig.plan.model_copy(update={"poses": 6, "revisit": revisit})
    return rig.model_copy(update={"plan": plan})


def ports_in(rig: Rig, folder: Path) -> dict[str, str]:
    return {port.name: str(folder / port.name) for port in rig.ports}


def assert_timing_is_true(timing: DeviceTiming, rig: str) -> None:
    """Answers took some time; where a device has a clock, it is as fast as its crystal."""
    assert timing.shortest_ns is not None
    assert 0 < timing.shortest_ns < 50_000_000
    if timing.clock is None:
        assert rig != "arm" or not timing.device.startswith("encoder")
        return
    error_ppb = -1e9 * crystal_of(timing.device).error - timing.clock.drift_ppb
    # A busy computer may change its mind half way about how long everything takes.
    assert abs(error_ppb) < 8.0 * timing.clock.drift_uncertainty_ppb


@pytest.mark.wires
@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_a_shortened_plan_is_captured_without_an_unexplained_loss(
    name, tmp_path, patient, until_complete
):
    text = patient(rig_text(name)[0])
    rig = shortened(parse_rig(text))
    ports, clock = ports_in(rig, tmp_path), HostClock()

    def session(path: Path) -> CaptureSummary:
        with bench(name, ports):
            links = make_links(rig, clock, ports)
            return capture(rig, text, path, links=links, clock=clock)

    summary = until_complete(session)
    assert summary.ending is Ending.COMPLETE, (summary.why, summary.faults)
    assert len(summary.dwells) == len(visits(rig.plan))
    recording = read_recording(summary.path)
    for each in summary.timing:
        assert_timing_is_true(each, name)
    for channel in rig.channels:
        readings = recording.readings[channel.name]
        entry = summary.ledger[channel.name]
        assert entry.unaccounted == 0
        assert entry.received == len(readings.raw)
        for dwell in summary.dwells:
            inside = (readings.time_ns >= dwell.start_ns) & (readings.time_ns <= dwell.end_ns)
            counts = readings.raw[inside].astype(float)
            assert len(counts) >= 5  # of 30; a busy computer may lose most
            assert np.std(counts) < 3.0 * max(channel.noise, 1.0)


@pytest.mark.wires
def test_devices_that_are_not_there_are_all_named(tmp_path):
    rig = load_rig("arm")
    ports, clock = ports_in(rig, tmp_path), HostClock()
    links = make_links(rig, clock, ports)
    with pytest.raises(NotReady) as caught:
        capture(rig, rig_text("arm")[0], tmp_path / "arm.mcap", links=links, clock=clock)
    assert len(caught.value.missing) == 2
    assert not (tmp_path / "arm.mcap").exists()
