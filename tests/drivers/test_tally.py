"""Every reading that was asked for is accounted for."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.faults import FaultThrottle
from drivers.link import Losses
from drivers.schedule import SECOND
from drivers.tally import Tally
from recordings.events import Fault
from recordings.faults import FaultKind


def test_a_reading_under_way_is_neither_expected_nor_lost():
    tally = Tally()
    tally.ask()
    assert tally.losses() == Losses(0, 0, 0, 0)
    tally.receive()
    assert tally.losses() == Losses(1, 0, 0, 0)


def test_a_request_that_stays_unanswered_is_dropped_by_the_device():
    tally = Tally()
    tally.ask()
    tally.ask()
    assert tally.losses() == Losses(1, 1, 0, 0)
    tally.give_up()
    assert tally.losses() == Losses(2, 2, 0, 0)


def test_a_late_reading_is_taken_off_the_losses():
    tally = Tally()
    tally.ask()
    tally.ask()
    tally.receive()
    tally.receive()
    assert tally.losses() == Losses(2, 0, 0, 0)


def test_a_step_of_the_sample_counter_is_a_gap():
    tally = Tally()
    for _ in range(4):
        tally.ask()
    tally.receive(missed=3)
    assert tally.losses() == Losses(4, 0, 3, 1)


def test_a_counter_cannot_explain_more_than_is_missing():
    tally = Tally()
    tally.ask()
    tally.receive(missed=40_000)
    assert tally.losses() == Losses(1, 0, 0, 1)


def test_an_outage_takes_what_was_under_way_and_what_was_due():
    tally = Tally()
    tally.ask()
    tally.begin_gap()
    tally.lose(7)
    tally.ask()
    tally.receive()
    assert tally.losses() == Losses(9, 0, 8, 1)


def test_a_reading_that_came_unasked_is_expected_too():
    tally = Tally()
    tally.receive_unasked()
    assert tally.losses() == Losses(1, 0, 0, 0)


ACTIONS = st.sampled_from(["ask", "receive", "step", "unasked", "gap", "lose", "skip", "give_up"])


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.lists(ACTIONS, max_size=60))
def test_the_balance_is_whole_at_every_moment(actions: list[str]):
    tally, received = Tally(), 0
    for action in actions:
        if action == "ask":
            tally.ask()
        elif action in ("receive", "step"):
            tally.receive(missed=3 if action == "step" else 0)
            received += 1
        elif action == "unasked":
            tally.receive_unasked()
            received += 1
        elif action == "gap":
            tally.begin_gap()
        elif action == "skip":
            tally.skip(2)
        elif action == "lose":
            tally.lose(2)
        else:
            tally.give_up()
        losses = tally.losses()
        assert losses.expected - received == losses.dropped_by_device + losses.lost_in_gaps
        assert min(losses.expected, losses.dropped_by_device, losses.lost_in_gaps) >= 0


def test_a_repeated_fault_is_reported_once_and_then_summed_up():
    throttle = FaultThrottle()
    fault = [Fault(n, "bus", FaultKind.MALFORMED, f"bad {n}") for n in range(5)]
    assert throttle.offer(fault[0]) == [fault[0]]
    assert [throttle.offer(f) for f in fault[1:]] == [[]] * 4
    assert throttle.due(0) == throttle.due(SECOND // 2) == []
    again = Fault(SECOND // 2, "bus", FaultKind.MALFORMED, "bad 5")
    assert throttle.offer(again) == []
    (summary,) = throttle.due(SECOND)
    assert summary.text == "5 more times; the last: bad 5"
    assert throttle.due(3 * SECOND // 2 - 1) == []
    (over,) = throttle.due(2 * SECOND - 1)
    assert (over.source, over.kind) == ("bus", FaultKind.MALFORMED_OVER)
    assert over.text == "malformed 6 times in 0.5 s, and not for 1 s since; the last: bad 5"
    assert throttle.due(3 * SECOND) == []
    assert throttle.offer(fault[1]) == [fault[1]]


def test_a_fault_that_ends_in_its_own_way_is_not_called_over():
    throttle = FaultThrottle()
    assert throttle.offer(Fault(0, "a", FaultKind.SILENT, "")) != []
    assert throttle.due(2 * SECOND) == []


def test_faults_of_other_sources_and_kinds_are_not_held_back():
    throttle = FaultThrottle()
    faults = [
        Fault(0, "a", FaultKind.SILENT, ""),
        Fault(0, "b", FaultKind.SILENT, ""),
        Fault(0, "a", FaultKind.LATE, ""),
    ]
    assert [throttle.offer(f) for f in faults] == [[f] for f in faults]
