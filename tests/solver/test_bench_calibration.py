"""Bench calibration against scipy's regression, known truths, and tables that show nothing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from solver.bench_calibration import bench_calibration
from solver.errors import NotEnoughData

GAIN, ZERO, NOISE = 2.93e-5, 2051.4, 3.0
STATIONS = np.linspace(-0.05, 0.05, 21)


def table(rng: np.random.Generator, repeats: int, bend: float = 0.0) -> tuple[np.ndarray, ...]:
    x = np.repeat(STATIONS, repeats)
    y = ZERO + x / GAIN + bend * np.sin(60.0 * x) + NOISE * rng.standard_normal(len(x))
    return x, y


def test_single_readings_agree_with_scipy() -> None:
    x, y = table(np.random.default_rng(1), 1)
    found, line = bench_calibration(x, y), stats.linregress(x, y)
    assert found.gain.value == pytest.approx(1 / line.slope, rel=1e-10)
    assert found.gain.standard_error == pytest.approx(line.stderr / line.slope**2, rel=1e-8)
    assert found.zero.value == pytest.approx(line.intercept, rel=1e-10)
    assert found.zero.standard_error == pytest.approx(line.intercept_stderr, rel=1e-8)
    residual = y - np.polyval(np.polyfit(x, y, 1), x)
    scale = abs(line.slope) * np.ptp(x)
    assert found.linearity.value == pytest.approx(100 * np.abs(residual).max() / scale, rel=1e-8)
    assert not found.repeated


def test_repeated_readings_find_the_truth_within_their_standard_errors() -> None:
    pulls = []
    for seed in range(300):
        found = bench_calibration(*table(np.random.default_rng(seed), 5))
        pulls.append(
            [
                (found.gain.value - GAIN) / found.gain.standard_error,
                (found.zero.value - ZERO) / found.zero.standard_error,
                (found.noise.value - NOISE) / found.noise.standard_error,
            ]
        )
    spread = np.std(pulls, axis=0)
    np.testing.assert_allclose(np.mean(pulls, axis=0), 0.0, atol=0.25)
    np.testing.assert_allclose(spread, 1.0, atol=0.15)


def test_a_bend_is_linearity_and_widens_standard_errors() -> None:
    straight = bench_calibration(*table(np.random.default_rng(2), 8))
    bent = bench_calibration(*table(np.random.default_rng(2), 8, bend=40.0))
    exact = 40.0 * np.sin(60.0 * STATIONS)
    off = exact - np.polyval(np.polyfit(STATIONS, exact, 1), STATIONS)
    expected = 100 * np.abs(off).max() / bent.full_scale
    assert straight.inflation == 1.0
    assert bent.inflation > 3.0
    assert abs(bent.linearity.value - expected) < 4 * bent.linearity.standard_error
    assert bent.noise.value == pytest.approx(straight.noise.value, rel=1e-9)
    assert bent.gain.standard_error > 3 * straight.gain.standard_error


def test_order_of_rows_and_unit_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    x, y = table(rng, 3)
    mixed = rng.permutation(len(x))
    one, other = bench_calibration(x, y), bench_calibration(1e3 * x[mixed], y[mixed])
    assert other.gain.value == pytest.approx(1e3 * one.gain.value, rel=1e-10)
    assert other.zero.value == pytest.approx(one.zero.value, rel=1e-10)
    assert other.linearity.value == pytest.approx(one.linearity.value, rel=1e-9)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ([0.0, 1.0], [0.0, 1.0], "at least 3"),
        ([0.0, 1.0, 2.0], [1.0, 2.0], "as many"),
        ([0.0, 1.0, np.nan], [1.0, 2.0, 3.0], "not finite"),
        ([0.0, 1.0, 2.0, 3.0], [5.0, 7.0, 7.0, 5.0], "wiring"),
        ([0.0, 1.0, 2.0, 3.0], [5.0, 5.0, 5.0, 5.0], "wiring"),
    ],
)
def test_tables_that_show_no_line_are_refused(x: list[float], y: list[float], words: str) -> None:
    with pytest.raises(NotEnoughData, match=words):
        bench_calibration(x, y)
