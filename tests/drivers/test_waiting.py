"""Waiting on a host that is held up itself, and who may be called silent then."""

from __future__ import annotations

import time

import pytest

from drivers.silence import STEP_NS, SilenceWatch
from drivers.waiting import LONGEST_WAIT_S, waits
from sim_devices.virtual_time import VirtualClock, time_is

SECOND = 1_000_000_000
MS = 1_000_000


@pytest.fixture
def virtual(clock):
    with time_is(clock):
        yield clock


def test_waits_add_up_to_their_time(virtual: VirtualClock):
    asked = []
    for wait_s in waits(0.12):
        asked.append(wait_s)
        time.sleep(wait_s)
    assert asked == pytest.approx([LONGEST_WAIT_S, LONGEST_WAIT_S, 0.02])
    assert virtual.time_s == pytest.approx(0.12)


def test_what_does_not_wait_for_its_whole_time_is_asked_again(virtual: VirtualClock):
    asked = 0
    for _ in waits(0.1):
        asked += 1
        time.sleep(0.004)
    assert asked == 25


def test_a_wait_that_the_host_slept_in_counts_as_what_it_was_to_last(virtual: VirtualClock):
    asked = []
    for wait_s in waits(0.2):
        asked.append(wait_s)
        time.sleep(30.0 if len(asked) == 2 else wait_s)
    assert asked[:4] == pytest.approx([0.05] * 4)
    assert sum(asked) == pytest.approx(0.2)


def test_behind_a_last_wait_that_the_host_slept_in_comes_a_last_look(virtual: VirtualClock):
    asked = []
    for wait_s in waits(0.05):
        asked.append(wait_s)
        time.sleep(30.0)
    assert asked == [0.05, 0.0]


def test_there_is_one_look_at_least():
    assert list(waits(0.0)) == [0.0]


@pytest.mark.parametrize("timeout_ms", [100, 500, 1000])
def test_silence_is_noticed_at_its_time_by_who_looks_regularly(timeout_ms: int):
    watch = SilenceWatch(timeout_ms * MS)
    watch.begin(0)
    assert not watch.hear(7 * MS)
    noticed = [n for n in range(200) if watch.falls_silent(n * 10 * MS)]
    assert noticed == [timeout_ms // 10 + 1]
    assert watch.silent
    assert watch.hear(3 * SECOND)
    assert not watch.silent


@pytest.mark.parametrize("timeout_ms", [100, 500, 1000])
def test_nobody_is_called_silent_because_nobody_listened(timeout_ms: int):
    watch = SilenceWatch(timeout_ms * MS)
    watch.begin(0)
    for hour in range(1, 10):
        now_ns = hour * 3600 * SECOND
        assert not watch.falls_silent(now_ns)
        assert not watch.hear(now_ns)


def test_a_host_that_is_always_slow_notices_late_and_notices():
    watch = SilenceWatch(SECOND)
    watch.begin(0)
    assert [watch.falls_silent(n * SECOND) for n in range(1, 20)].index(True) == SECOND // STEP_NS


def test_nothing_is_missed_that_is_not_expected():
    watch = SilenceWatch(SECOND)
    assert not any(watch.falls_silent(n * 100 * MS) for n in range(100))
    watch.begin(0)
    watch.end()
    assert not any(watch.falls_silent(n * 100 * MS) for n in range(100))
    assert not watch.hear(SECOND)
