"""From samples to averaged poses: noise, correlation, dwells that still moved, encoders that wrap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from recordings.events import Dwell, ReadingFlag
from recordings.recording import Readings, Recording
from recordings.rig import Rig, load_rig
from recordings.session import Session
from solver.errors import NotEnoughData
from solver.samples import average, track

Array = NDArray[np.float64]

SAMPLE_NS = 10_000_000


def _recording(rig: Rig, dwells: Array, *, told: bool = True) -> Recording:
    """Dwells (P, C, S) [counts] one after the other, with dwell messages where ``told``."""
    poses, channels, samples = dwells.shape
    time = np.arange(poses * samples, dtype=np.int64) * SAMPLE_NS
    readings = {}
    for c in range(channels):
        name = rig.channels[c].name
        raw = np.round(dwells[:, c].ravel()).astype(np.int64)
        readings[name] = Readings(name, time, raw, None, None, np.zeros(len(raw), dtype=np.uint32))
    spans = [(i * samples * SAMPLE_NS, ((i + 1) * samples - 1) * SAMPLE_NS) for i in range(poses)]
    return Recording(
        path=Path("in-memory"),
        rig=rig,
        rig_toml="",
        session=Session(),
        readings=readings,
        dwells=tuple(Dwell(s, s, e, i, 0) for i, (s, e) in enumerate(spans)) if told else (),
        marks=(),
        faults=(),
        mode_commands=(),
        mode_reports=(),
        clock=(),
        ledger={},
    )


def _dwells(sigma: Array, *, poses: int = 40, samples: int = 50, seed: int = 1) -> Array:
    rng = np.random.default_rng(seed)
    levels = 1000.0 + 500 * rng.standard_normal((poses, len(sigma), 1))
    return levels + sigma[:, None] * rng.standard_normal((poses, len(sigma), samples))


def test_means_noise_and_their_errors() -> None:
    rig = load_rig("shoulder")
    sigma = np.array([2.0, 5.0, 10.0, 20.0])
    dwells = _dwells(sigma)
    table = average(_recording(rig, dwells))
    assert table.channels == ("d1", "d2", "d3", "d4")
    np.testing.assert_allclose(table.counts, np.round(dwells).mean(axis=2))
    np.testing.assert_allclose(table.noise, np.sqrt(sigma**2 + 1 / 12), rtol=0.05)
    np.testing.assert_allclose(table.correlation, 1.0, atol=0.2)
    np.testing.assert_allclose(
        table.sigma, table.noise * np.sqrt(table.correlation / 50) * np.ones((40, 4)), rtol=1e-9
    )
    assert (table.samples == 50).all()
    assert table.rejected == ()


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8])
def test_correlated_noise_is_worth_fewer_samples(memory: float) -> None:
    """First-order autoregression: the integrated time is (1 + rho) / (1 - rho)."""
    rig = load_rig("shoulder")
    rng = np.random.default_rng(2)
    white = 10.0 * rng.standard_normal((60, 4, 500))
    noise = np.empty((60, 4, 300))
    state = white[:, :, 0] / np.sqrt(1 - memory**2)
    for i in range(499):
        state = memory * state + white[:, :, i + 1]
        if i >= 199:
            noise[:, :, i - 199] = state
    table = average(_recording(rig, 500.0 + noise))
    expected = (1 + memory) / (1 - memory)
    np.testing.assert_allclose(table.correlation, expected, rtol=0.2)
    np.testing.assert_allclose(table.effective, 300 / table.correlation * np.ones((60, 4)))
    # What it is for: the spread of the means is what sigma says.
    spread = np.sqrt(np.mean((table.counts - 500.0) ** 2 / table.sigma**2))
    assert spread == pytest.approx(1.0, abs=0.12)


def test_a_quiet_channel_is_no_better_than_its_quantisation() -> None:
    table = average(_recording(load_rig("shoulder"), _dwells(np.array([0.0, 0.0, 0.1, 9.0]))))
    assert (table.sigma[:, :3] >= np.sqrt(1 / 12)).all()
    assert (table.sigma[:, 3] < 2.0).all()


def test_a_dwell_in_which_a_channel_still_moved_is_rejected_and_named() -> None:
    dwells = _dwells(np.full(4, 3.0))
    dwells[7, 2] += np.linspace(-20, 20, 50)
    table = average(_recording(load_rig("shoulder"), dwells))
    assert [r.window.pose for r in table.rejected] == [7]
    assert "still moving: d3 moved" in table.rejected[0].reason
    assert len(table.counts) == 39
    assert 7 not in [w.pose for w in table.windows]
    # Its motion does not count as noise of the others.
    assert table.noise[2] == pytest.approx(3.0, rel=0.05)


def test_a_channel_that_creeps_in_every_dwell_is_not_taken_for_noise() -> None:
    dwells = _dwells(np.full(4, 3.0))
    dwells[:, 1] += np.linspace(-20, 20, 50)
    with pytest.raises(NotEnoughData, match="still moved in all 40 dwells"):
        average(_recording(load_rig("shoulder"), dwells))


def test_hardly_any_dwell_at_rest_is_rejected() -> None:
    table = average(_recording(load_rig("shoulder"), _dwells(np.full(4, 3.0), poses=400)))
    assert len(table.rejected) <= 1


def test_dwells_without_samples_are_told() -> None:
    recording = _recording(load_rig("shoulder"), _dwells(np.full(4, 3.0), poses=4))
    late = Dwell(0, 10**15, 10**15 + 1, 4, 0)
    with_late = Recording(
        **{
            name: getattr(recording, name)
            for name in Recording.__slots__
            if name not in ("dwells", "damage")
        },
        dwells=(*recording.dwells, late),
    )
    table = average(with_late)
    assert [r.window.pose for r in table.rejected] == [4]
    assert "fewer than 4 samples of d1, d2, d3, d4" in table.rejected[0].reason


def test_motion_in_a_third_of_the_dwells_is_not_taken_for_noise() -> None:
    dwells = _dwells(np.full(4, 1.0), poses=60)
    dwells[:20] += np.linspace(-400, 400, 50)
    table = average(_recording(load_rig("shoulder"), dwells))
    assert [r.window.pose for r in table.rejected] == list(range(20))
    np.testing.assert_allclose(table.noise, np.sqrt(1 + 1 / 12), rtol=0.06)


def test_a_silent_channel_is_named() -> None:
    recording = _recording(load_rig("shoulder"), _dwells(np.full(4, 1.0), poses=6)[:, :3])
    with pytest.raises(NotEnoughData, match="no readings of channel 'd4'; it has: d1, d2, d3"):
        average(recording)


def test_dwells_are_found_where_none_were_recorded() -> None:
    levels = np.repeat(
        np.random.default_rng(3).uniform(500, 3000, (5, 4, 1)), 120, axis=2
    ) + 3.0 * np.random.default_rng(4).standard_normal((5, 4, 120))
    table = average(_recording(load_rig("shoulder"), levels, told=False), shortest_s=0.4)
    assert len(table.counts) == 5
    np.testing.assert_allclose(table.counts, levels.mean(axis=2), atol=3.0)


def test_a_rotary_encoder_is_unwrapped_near_its_zero() -> None:
    rig = load_rig("shoulder")
    wrapping = rig.channels[0].model_copy(update={"modulus_counts": 4096, "zero_count": 0})
    rig = rig.model_copy(update={"channels": (wrapping, *rig.channels[1:])})
    turning = np.tile(np.linspace(-300, 300, 50), (1, 4, 1))
    recording = _recording(rig, np.mod(turning, 4096))
    unwrapped = track(recording, wrapping).counts
    np.testing.assert_allclose(unwrapped, np.round(turning[0, 0]), atol=1.0)
    assert np.abs(np.diff(unwrapped)).max() < 20


def test_readings_that_are_no_measurement_are_left_out() -> None:
    rig = load_rig("shoulder")
    recording = _recording(rig, _dwells(np.full(4, 2.0), poses=3))
    name = rig.channels[0].name
    good = recording.readings[name]
    raw, flags = good.raw.copy(), good.flags.copy()
    raw[::10], flags[::10] = 0, ReadingFlag.DEVICE_ERROR
    raw[5::10], flags[5::10] = raw[4::10], ReadingFlag.STALE
    flags[1::10] = ReadingFlag.OVERRANGE
    spoilt = replace(good, raw=raw, flags=flags)
    found = track(
        replace(recording, readings={**recording.readings, name: spoilt}), rig.channels[0]
    )
    kept = np.ones(len(raw), dtype=bool)
    kept[::10] = kept[5::10] = False
    assert found.counts.tolist() == good.raw[kept].tolist()
    assert found.time_ns.tolist() == good.time_ns[kept].tolist()


def test_a_channel_without_a_measurement_is_named() -> None:
    rig = load_rig("shoulder")
    recording = _recording(rig, _dwells(np.full(4, 2.0), poses=3))
    name = rig.channels[0].name
    good = recording.readings[name]
    spoilt = replace(good, flags=np.full_like(good.flags, ReadingFlag.STALE))
    with pytest.raises(NotEnoughData, match="all 150 readings of channel 'd1' are flagged"):
        track(replace(recording, readings={**recording.readings, name: spoilt}), rig.channels[0])
