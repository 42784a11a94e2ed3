"""Readings in motion: where samples were lost, none is made up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from recordings.reader import Readings, Recording, read_recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.motion import with_motion
from solver.samples import average

RIG = load_rig("arm")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("motion") / "arm.mcap"
    simulate(RIG, rig_text("arm")[0], path, seed=5)
    return read_recording(path)


def kept(readings: Readings, keep: NDArray[np.bool_]) -> Readings:
    parts = ("time_ns", "raw", "flags", "device_time_ns", "sequence")
    columns = {part: getattr(readings, part) for part in parts}
    return replace(readings, **{p: None if c is None else c[keep] for p, c in columns.items()})


def one_move(recording: Recording, lost: tuple[float, float] | None) -> Recording:
    """Two dwells with a steady move between them, of which the samples of a time [s] are lost."""
    rate = 100.0
    time_s = np.arange(0.0, 5.0, 1.0 / rate)
    way = np.clip(time_s - 1.0, 0.0, 2.0)  # the move takes from 1 s to 3 s
    sequence = np.arange(len(time_s), dtype=np.uint32)
    there = np.ones(len(time_s), bool)
    if lost is not None:
        there = (time_s <= lost[0]) | (time_s >= lost[1])
    start_ns = recording.session.start_ns
    rng = np.random.default_rng(4)
    readings = {}
    for number, (name, each) in enumerate(recording.readings.items()):
        raw = np.round(each.raw[0] + 500.0 * (number + 1) * way + rng.normal(0.0, 0.5, len(way)))
        readings[name] = replace(
            each,
            time_ns=(start_ns + np.round(time_s * 1e9)).astype(np.int64)[there],
            raw=raw.astype(np.int64)[there],
            device_time_ns=None,
            sequence=sequence[there],
            flags=np.zeros(int(there.sum()), np.uint32),
        )
    dwells = tuple(
        replace(each, start_ns=start_ns + begin, end_ns=start_ns + begin + 300_000_000)
        for each, begin in zip(recording.dwells[:2], (500_000_000, 4_200_000_000), strict=True)
    )
    return replace(recording, readings=readings, dwells=dwells, clock=(), round_trips=())


def passes_through(recording: Recording, counts: NDArray[np.float64], at_ns: int) -> bool:
    """Whether ``counts`` lie between what the channels really read about ``at_ns``."""
    for channel, found in zip(RIG.channels, counts, strict=True):
        readings = recording.readings[channel.name]
        middle = int(np.searchsorted(readings.time_ns, at_ns))
        near = readings.raw[max(middle - 2, 0) : middle + 2]
        noise = 6.0 * max(channel.noise, 1.0)
        if not near.min() - noise <= found <= near.max() + noise:
            return False
    return True


def motion_rows(recording: Recording) -> list[tuple[NDArray[np.float64], int]]:
    still = average(recording)
    table, _ = with_motion(recording, still)
    first = len(still.counts)
    return [
        (counts, window.start_ns)
        for counts, window in zip(table.counts[first:], table.windows[first:], strict=True)
    ]


def test_rows_lie_on_the_way(simulated: Recording) -> None:
    rows = motion_rows(simulated)
    assert len(rows) > 30
    assert all(passes_through(simulated, *row) for row in rows)


def test_a_steady_move_is_read_on_its_way(simulated: Recording) -> None:
    rows = motion_rows(one_move(simulated, None))
    assert len(rows) == 2
    assert all(passes_through(one_move(simulated, None), *row) for row in rows)


@pytest.mark.parametrize("lost", [(1.5, 3.1), (1.2, 1.9), (2.0, 2.1), (0.9, 2.5)])
def test_no_row_is_made_up_where_samples_are_lost(
    simulated: Recording, lost: tuple[float, float]
) -> None:
    """A cubic through what was left on either side would pass, and lie anywhere in between."""
    whole, rows = one_move(simulated, None), motion_rows(one_move(simulated, lost))
    assert all(passes_through(whole, *row) for row in rows)
    assert not any(lost[0] < (at_ns - whole.session.start_ns) * 1e-9 < lost[1] for _, at_ns in rows)


def test_a_lost_sample_here_and_there_costs_little(simulated: Recording) -> None:
    rng = np.random.default_rng(3)
    readings = {
        name: kept(each, rng.random(len(each)) > 0.01) for name, each in simulated.readings.items()
    }
    rows = motion_rows(replace(simulated, readings=readings))
    assert len(rows) > 0.8 * len(motion_rows(simulated))
    assert all(passes_through(simulated, *row) for row in rows)
