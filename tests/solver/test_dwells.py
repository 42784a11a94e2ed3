"""Finding standstill from readings alone: noise while moving, windows between moves, nothing where nothing rests."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from solver.dwells import Track, Window, noise, standstills, without_edges

Array = NDArray[np.float64]

RATE_HZ = 100.0


def _track(counts: Array) -> Track:
    return Track((np.arange(len(counts)) / RATE_HZ * 1e9).astype(np.int64), counts)


def _moves(levels: list[float], *, rest_s: float = 1.0, move_s: float = 0.5) -> Array:
    """A joint that rests at each of ``levels`` and moves smoothly between them."""
    rest, move = int(rest_s * RATE_HZ), int(move_s * RATE_HZ)
    ease = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, move))
    parts = [np.full(rest, levels[0])]
    for before, after in pairwise(levels):
        parts += [before + (after - before) * ease, np.full(rest, after)]
    return np.concatenate(parts)


@pytest.mark.parametrize("sigma", [1.0, 5.0, 40.0])
def test_noise_is_that_of_rest_though_the_joint_moves(sigma: float) -> None:
    rng = np.random.default_rng(1)
    clean = _moves([0.0, 3000.0, -2000.0, 500.0])
    measured = noise(_track(clean + sigma * rng.standard_normal(len(clean))))
    assert measured == pytest.approx(sigma, rel=0.25)


def test_a_silent_channel_is_as_noisy_as_its_quantisation() -> None:
    assert noise(_track(np.full(500, 7.0))) == pytest.approx(0.3)
    assert noise(_track(np.zeros(5))) == pytest.approx(0.3)


def test_every_rest_is_found_once_and_no_move_is_in_it() -> None:
    rng = np.random.default_rng(2)
    first, second = _moves([0.0, 900.0, 900.0, -400.0]), _moves([0.0, 0.0, 700.0, 700.0])
    tracks = {
        "a": _track(first + 2 * rng.standard_normal(len(first))),
        "b": _track(second + 3 * rng.standard_normal(len(second))),
    }
    found = standstills(tracks, shortest_s=0.5)
    # Each of the three transitions moves one channel at least.
    assert [w.pose for w in found] == [0, 1, 2, 3]
    for number, window in enumerate(found):
        begins, ends = 1.5 * number, 1.5 * number + 1.0
        assert window.start_ns / 1e9 >= begins - 0.1
        assert window.end_ns / 1e9 <= ends + 0.1
        assert (window.end_ns - window.start_ns) / 1e9 > 0.6


def test_rests_that_are_too_short_do_not_count() -> None:
    clean = _moves([0.0, 900.0, -400.0], rest_s=0.4)
    assert standstills({"a": _track(clean)}, shortest_s=1.0) == ()


def test_a_creeping_joint_never_stands_still() -> None:
    rng = np.random.default_rng(3)
    creeping = 200.0 * np.arange(600) / RATE_HZ + rng.standard_normal(600)
    assert standstills({"a": _track(creeping)}, shortest_s=0.5) == ()


def test_all_channels_must_be_there() -> None:
    still = _track(np.zeros(500))
    assert standstills({}, shortest_s=0.3) == ()
    assert standstills({"a": still, "b": _track(np.zeros(2))}, shortest_s=0.3) == ()


def test_edges_are_cut_and_what_vanishes_is_dropped() -> None:
    windows = [Window(0, 1_000_000_000, 0, 0), Window(0, 150_000_000, 1, 0)]
    assert without_edges(windows, 0.08) == (Window(80_000_000, 920_000_000, 0, 0),)
