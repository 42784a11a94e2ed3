"""Noise of readings: white, correlated, heavy-tailed, and from visit to visit."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import parse_rig, rig_text
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.noise import Noise
from sim_devices.plant.stop import Stop
from sim_devices.simulate import simulate

COUNT = 200_000


def drawn(noise, seed=0):
    return noise.samples(np.random.default_rng(seed), COUNT)


@pytest.mark.parametrize("heavy", [False, True])
@pytest.mark.parametrize("correlation", [0.0, 5.0])
def test_every_noise_has_unit_variance(heavy, correlation):
    spread = drawn(Noise(correlation_samples=correlation, heavy_tails=heavy)).std()
    assert spread == pytest.approx(1.0, abs=0.08 if heavy else 0.02)


def test_plain_noise_is_what_the_generator_gives():
    expected = np.random.default_rng(0).standard_normal(COUNT)
    np.testing.assert_array_equal(drawn(Noise()), expected)


def test_correlation_decays_as_asked():
    off = drawn(Noise(correlation_samples=5.0))
    for lag in (1, 5, 10):
        assert np.corrcoef(off[lag:], off[:-lag])[0, 1] == pytest.approx(np.exp(-lag / 5), abs=0.02)


def test_heavy_tails_are_heavy():
    far = np.mean(np.abs(drawn(Noise(heavy_tails=True))) > 5)
    assert far > 1e-3 > np.mean(np.abs(drawn(Noise())) > 5)


def test_a_visit_adds_one_number_until_the_next_begins():
    stops = tuple(Stop(k, 0, 2.0 * k, 2.0 * k + 1, 2.0 * k + 1.2, 2.0 * k + 2) for k in range(300))
    text, source = rig_text("arm")
    plan = parse_rig(text, source).plan
    time_s = np.arange(0.0, 600.0, 0.1)
    added = Noise(visits=2.0).of_visits(1, 0, time_s, stops, plan)
    each = added.reshape(300, 20)
    np.testing.assert_array_equal(each, np.repeat(each[:, :1], 20, axis=1))
    of_mean = 1 / np.sqrt(plan.dwell * plan.sample)
    assert each[:, 0].std() == pytest.approx(2.0 * of_mean, rel=0.1)
    assert np.all(Noise().of_visits(1, 0, time_s, stops, plan) == 0.0)
    other = Noise(visits=2.0).of_visits(1, 1, time_s, stops, plan)
    assert abs(np.corrcoef(added, other)[0, 1]) < 0.2


def test_a_recording_is_as_noisy_as_asked_and_else_the_same(tmp_path):
    text, source = rig_text("shoulder")
    rig = parse_rig(text, source)
    kinds = {
        "plain": None,
        "white": Noise(),
        "slow": Noise(correlation_samples=5.0),
        "ugly": Noise(correlation_samples=5.0, heavy_tails=True, visits=1.0),
    }
    read = {}
    for name, noise in kinds.items():
        truth = simulate(rig, text, tmp_path / name, poses=3, seed=2, noise=noise)
        assert truth.effects == ()
        read[name] = read_recording(tmp_path / name).readings["d1"].raw
    np.testing.assert_array_equal(read["plain"], read["white"])
    first = slice(0, 25)  # the plate rests at first
    assert not np.array_equal(read["slow"], read["ugly"])
    assert (
        np.abs(np.diff(read["slow"][first])).mean() < np.abs(np.diff(read["white"][first])).mean()
    )


@pytest.mark.parametrize("bad", [{"visits": -1.0}, {"correlation_samples": np.nan}])
def test_impossible_noise_is_refused(bad):
    with pytest.raises(CannotSimulate, match="expected finite numbers, 0 or above"):
        Noise(**bad)
