"""How long answers take is told once a second, and never shorter than it was."""

from __future__ import annotations

from drivers.canopen.doubles import DoubleWatch
from drivers.round_trips import RoundTrips
from recordings.events import RoundTrip

MS = 1_000_000


def test_shortest_and_longest_of_a_second_are_told() -> None:
    trips = RoundTrips("adc")
    told = []
    for number in range(250):
        asked = number * 10 * MS
        told += trips.answered(asked, asked + (5 if number % 7 else 3) * MS + (number == 30) * MS)
    assert told == [
        RoundTrip("adc", 1_005 * MS, 3 * MS, 6 * MS),
        RoundTrip("adc", 2_015 * MS, 3 * MS, 5 * MS),
    ]
    assert trips.answered(None, 5_000 * MS) == ()


def test_late_and_lost_answers_do_not_make_a_node_look_quicker() -> None:
    """Answers that take 15 ms to requests every 10 ms, one in ten lost."""
    watch, taken = DoubleWatch(), []
    due: list[tuple[int, int]] = []
    for number in range(2000):
        now = number * 10 * MS
        while due and due[0][0] <= now:
            arrives, asked = due.pop(0)
            watch.answer(arrives)
            assert watch.asked_ns is not None
            taken.append((arrives - watch.asked_ns, arrives - asked))
        watch.ask(now)
        if number % 10 != 5:
            due.append((now + 15 * MS, now))
    assert all(said >= true for said, true in taken)
    assert min(said for said, _ in taken) == 15 * MS
