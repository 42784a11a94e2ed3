"""Watches that count: babble by rate, doubled nodes by answers and beats, refusals in a row."""

from __future__ import annotations

import random

from drivers.babble import Babble, BabbleWatch
from drivers.canopen.beat import BEAT_MS, BeatWatch
from drivers.canopen.doubles import SURPLUS, DoubleWatch
from drivers.slcan import REFUSED_IN_A_ROW, Refusals
from recordings.events import Fault
from recordings.faults import FaultKind

SECOND = 1_000_000_000
MS = 1_000_000
BABBLE = Babble("bus1", "bus", "frames a second", "a device babbles")


def babble_changes(counts: list[int]) -> list[int]:
    """The tenths of a second at which the babble changes, for so much in each of them."""
    watch, changes = BabbleWatch(BABBLE, 1000.0), []
    for tenth, count in enumerate(counts):
        if watch.look(tenth * SECOND // 10):
            changes.append(tenth)
        watch.hear(count)
    return changes


def test_babble_is_told_with_its_rate_and_its_likely_cause():
    watch = BabbleWatch(BABBLE, 1000.0)
    assert watch.look(0) == ()
    watch.hear(500)
    (begins,) = watch.look(250 * MS)
    text = "2000 frames a second, above 1000: a device babbles"
    assert begins == Fault(250 * MS, "bus1", FaultKind.BABBLE, text)
    (ends,) = [fault for n in range(2, 9) for fault in watch.look(n * 250 * MS)]
    assert ends == Fault(1250 * MS, "bus1", FaultKind.QUIET, "the bus is quiet again")


def test_babble_is_a_rate_and_ends_after_a_second_of_quiet():
    assert babble_changes([50] * 50) == []
    assert babble_changes([500] * 20) == [3]
    assert babble_changes([0] * 5 + [500] * 10 + [0] * 30) == [6, 27]


def test_what_came_while_the_host_was_held_up_belongs_to_that_time():
    """A bus that others use too, at half of what would be babble, and a host that is away for 2 s."""
    watch = BabbleWatch(BABBLE, 1000.0)
    for tenth in [*range(10), *range(30, 60)]:
        assert watch.look(tenth * 100 * MS) == ()
        watch.hear(1000 if tenth == 30 else 50)


def test_a_host_that_is_always_slow_hears_babble_all_the_same():
    watch = BabbleWatch(BABBLE, 1000.0)
    told = []
    for second in range(6):
        told += watch.look(second * SECOND)
        watch.hear(5000)
    assert [fault.kind for fault in told] == [FaultKind.BABBLE]


def test_a_single_burst_below_the_rate_is_no_babble():
    assert babble_changes([240] + [0] * 30) == []


def test_two_answers_to_each_request_are_two_nodes():
    watch, changes = DoubleWatch(), []
    for number in range(50):
        now_ns = number * 10 * MS
        watch.ask(now_ns)
        if any([watch.answer(now_ns + MS), watch.answer(now_ns + 2 * MS)]):
            changes.append(number + 1)
    assert changes == [SURPLUS]
    ends = [n for n in range(50, 300) if watch.ask(n * 10 * MS) or watch.answer(n * 10 * MS + MS)]
    assert len(ends) == 1
    assert not watch.doubled


def test_late_and_lost_answers_and_a_burst_after_a_stall_are_one_node():
    rng, watch = random.Random(3), DoubleWatch()
    waiting: list[int] = []
    for number in range(3000):
        now_ns = number * 10 * MS
        watch.ask(now_ns)
        if rng.random() > 0.05:
            waiting.append(number)
        stalled = 1000 <= number < 1100
        while waiting and not stalled and rng.random() > 0.2:
            waiting.pop(0)
            assert not watch.answer(now_ns)
    assert not watch.doubled


def test_answers_that_a_stall_of_seconds_held_up_are_those_of_one_node():
    watch = DoubleWatch()
    for number in range(800):
        now_ns = number * 10 * MS
        watch.ask(now_ns)
        # From 1 s to 6 s nothing comes; then all of it does.
        for _ in range(0 if 100 <= number < 600 else 501 if number == 600 else 1):
            assert not watch.answer(now_ns + MS)
    now_ns = 8 * SECOND
    assert [watch.answer(now_ns + n * MS) for n in range(SURPLUS + 1)].count(True) == 1


def test_beats_tell_silence_and_two_nodes():
    watch = BeatWatch()
    watch.begin(0)
    seen: list[tuple[int, str]] = []
    for ms in range(0, 12_000, 20):
        now_ns = ms * MS
        beats = 0 if 3000 <= ms < 5000 else 2 if 7000 <= ms < 9000 else 1
        if ms % BEAT_MS == 0 and sum(watch.hear(now_ns) for _ in range(beats)):
            seen.append((ms, "heard"))
        if watch.falls_silent(now_ns):
            seen.append((ms, "silent"))
        if watch.doubles(now_ns):
            seen.append((ms, "doubled" if watch.doubled else "single"))
    assert [what for _, what in seen] == ["silent", "heard", "doubled", "single"]
    assert 3800 <= seen[0][0] <= 3900
    assert 7000 <= seen[2][0] <= 8000


def test_a_node_that_nobody_listened_to_is_not_silent():
    watch = BeatWatch()
    watch.begin(0)
    assert not watch.falls_silent(100 * MS)
    assert not watch.falls_silent(9 * SECOND)
    # It is given most of the second that it has.
    assert [watch.falls_silent(9 * SECOND + n * 100 * MS) for n in range(1, 20)].index(True) == 7


def test_beats_that_come_at_once_behind_a_pause_are_those_of_one_node():
    watch = BeatWatch()
    watch.begin(0)
    for pause_ms in (600, 1700, 5000):
        now_ns = pause_ms * MS
        ends = watch.hear(now_ns)
        assert not any(watch.hear(now_ns) for _ in range(pause_ms // BEAT_MS))
        assert not ends
        assert not watch.doubles(now_ns + MS)
    doubled = [
        watch.hear(6 * SECOND + n * 100 * MS) or watch.doubles(6 * SECOND + n * 100 * MS)
        for n in range(30)
    ]
    assert doubled.count(True) == 1


def test_a_node_without_beats_is_never_silent():
    watch = BeatWatch()
    assert not any(watch.falls_silent(n * 100 * MS) for n in range(100))


def test_refusals_in_a_row_are_bus_off_and_single_ones_are_not():
    refusals = Refusals()
    assert [refusals.refused() for _ in range(2 * REFUSED_IN_A_ROW)].count(True) == 2
    assert not any(refusals.refused() or refusals.works() for _ in range(50))
