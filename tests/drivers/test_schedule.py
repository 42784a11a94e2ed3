"""Instants without drift, delays that grow, counters that wrap."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.counters import WrappingCounter
from drivers.schedule import SECOND, Backoff, Schedule


def test_the_first_instant_is_the_start():
    schedule = Schedule(100.0, 1000)
    assert schedule.due(999) == 0
    assert schedule.due(1000) == 1
    assert schedule.due(1000) == 0
    assert schedule.next_ns == 1000 + 10_000_000


def test_instants_a_little_late_are_served_one_by_one():
    schedule = Schedule(100.0, 0)
    assert schedule.due(0) == 1
    assert [schedule.due(35_000_000) for _ in range(4)] == [1, 1, 1, 0]
    assert schedule.next_ns == 40_000_000


def test_instants_that_are_too_late_are_given_up():
    schedule = Schedule(100.0, 0)
    assert schedule.due(0) == 1
    # 30 are waiting, 10 of them not later than the patience of 0.1 s.
    assert schedule.due(300_000_000) == 20
    assert [schedule.due(300_000_000) for _ in range(11)] == [1] * 10 + [0]
    assert schedule.next_ns == 310_000_000


def test_a_period_that_is_no_whole_number_of_nanoseconds_does_not_drift():
    schedule = Schedule(3.0, 0)
    hour = 3600
    while schedule.due(hour * SECOND):
        pass
    assert schedule.next_ns == hour * SECOND + round(SECOND / 3)


def test_late_service_does_not_shift_later_instants():
    schedule = Schedule(100.0, 0)
    for number in range(500):
        assert schedule.due(number * 10_000_000 + 3_000_000 * (number % 3)) == 1
    assert schedule.next_ns == 500 * 10_000_000


@settings(deadline=None, derandomize=True, max_examples=300)
@given(
    rate=st.floats(0.1, 5000.0),
    steps=st.lists(st.integers(0, 10**10), min_size=1, max_size=20),
)
def test_every_instant_is_counted_once(rate: float, steps: list[int]):
    schedule = Schedule(rate, 12345)
    now, total = 12345, 0
    for step in steps:
        now += step
        total += schedule.due(now)
    while served := schedule.due(now):
        total += served
    assert schedule.next_ns > now
    whole = 0
    fresh = Schedule(rate, 12345)
    while served := fresh.due(now):
        whole += served
    assert total == whole


def test_a_rate_of_nothing_is_refused():
    with pytest.raises(ValueError, match="above 0"):
        Schedule(0.0, 0)


def test_delays_double_up_to_the_cap():
    backoff = Backoff(0, first_s=0.5, cap_s=2.0)
    waits, now = [], 0
    for _ in range(4):
        waits.append((backoff.next_ns - now) / SECOND)
        now = backoff.next_ns
        backoff.failed(now)
    assert waits == [0.5, 1.0, 2.0, 2.0]


def test_a_counter_goes_on_across_its_wrap():
    counter = WrappingCounter(16)
    assert [counter.advance(raw) for raw in (65534, 65535, 0, 2)] == [0, 1, 1, 2]
    assert counter.value == 65538


def test_an_expected_step_tells_how_often_it_wrapped():
    counter = WrappingCounter(16)
    counter.advance(100)
    assert counter.advance(90, expected=3 * 65536) == 3 * 65536 - 10


def test_a_counter_that_went_back_says_so():
    counter = WrappingCounter(16)
    counter.advance(5000)
    assert counter.advance(3, expected=1) == -4997


@settings(deadline=None, derandomize=True, max_examples=300)
@given(start=st.integers(0, 65535), steps=st.lists(st.integers(-30000, 30000), max_size=30))
def test_any_walk_in_small_steps_is_recovered(start: int, steps: list[int]):
    counter = WrappingCounter(16)
    true = start
    counter.advance(true)
    for step in steps:
        true += step
        assert counter.advance(true % 65536) == step
    assert counter.value == true
