"""The standstill test against seeded noise and motion."""

from __future__ import annotations

import numpy as np
import pytest

from daq.standstill import Window, apart, moving, noise_of, stands_still

PERIOD_NS = 10_000_000


def window(counts) -> Window:
    return Window(np.arange(len(counts)) * PERIOD_NS, np.rint(counts).astype(np.int64))


@pytest.mark.parametrize("sigma", [0.0, 1.0, 5.12])
@pytest.mark.parametrize("n", [20, 40])
def test_noise_alone_is_still_in_at_least_998_of_1000_windows(sigma, n):
    rng = np.random.default_rng(7)
    still = [stands_still(window(sigma * rng.standard_normal(n)), sigma) for _ in range(1000)]
    assert sum(still) >= 998


def test_noise_three_times_that_of_the_rig_is_still_mostly_noise():
    rng = np.random.default_rng(8)
    still = [stands_still(window(3.0 * rng.standard_normal(40)), 1.0) for _ in range(1000)]
    assert sum(still) >= 980


@pytest.mark.parametrize("sigma", [0.0, 1.0, 5.12])
def test_a_drift_of_four_standard_deviations_over_the_window_is_motion(sigma):
    rng = np.random.default_rng(9)
    drift = 4.0 * max(sigma, 1.0)
    moved = [
        not stands_still(window(sigma * rng.standard_normal(40) + np.linspace(0, drift, 40)), sigma)
        for _ in range(1000)
    ]
    assert sum(moved) >= 950


def test_a_slow_swing_is_motion_although_it_comes_back():
    swing = 10.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 40))
    assert not stands_still(window(swing), 1.0)


def test_a_strong_vibration_is_not_taken_for_noise():
    rng = np.random.default_rng(10)
    assert not stands_still(window(40.0 * rng.standard_normal(40)), 1.0)


def test_where_the_rig_states_no_noise_the_window_says_it_itself():
    rng = np.random.default_rng(11)
    assert noise_of(window(20.0 * rng.standard_normal(4000)), 0.0) == pytest.approx(20.0, rel=0.05)
    assert stands_still(window(20.0 * rng.standard_normal(40)), 0.0)


def test_a_handful_of_samples_says_nothing():
    assert not stands_still(window([0, 0, 0, 0]), 1.0)


def test_a_channel_with_a_gap_counts_as_moving():
    still = window(np.zeros(40))
    late = Window(still.time_ns[:20], still.counts[:20])
    hole = Window(np.delete(still.time_ns, range(10, 25)), np.delete(still.counts, range(10, 25)))
    windows = {"whole": still, "ends early": late, "hole": hole}
    noise = dict.fromkeys(windows, 1.0)
    restless = moving(windows, noise, 0, 39 * PERIOD_NS, gap_ns=5 * PERIOD_NS)
    assert restless == ("ends early", "hole")


def test_two_places_are_apart_beyond_noise_only():
    rng = np.random.default_rng(12)
    here = {"q": window(2.0 * rng.standard_normal(40))}
    near = {"q": window(2.0 * rng.standard_normal(40) + 1.0)}
    away = {"q": window(2.0 * rng.standard_normal(40) + 60.0)}
    assert not apart(here, near, {"q": 2.0})
    assert apart(here, away, {"q": 2.0})
