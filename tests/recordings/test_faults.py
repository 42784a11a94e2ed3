"""Fault events as episodes: what begins, what ends it, and what is only a moment."""

from __future__ import annotations

from recordings.events import Fault
from recordings.faults import ENDED_BY, ENDS, Episode, FaultKind, episodes


def fault(time_ns: int, source: str, kind: str) -> Fault:
    return Fault(time_ns, source, kind, f"{source} {kind}")


def test_a_fault_that_lasts_ends_with_the_kind_that_belongs_to_it():
    found = episodes(
        [
            fault(1, "bus", FaultKind.BROKEN),
            fault(2, "adc", FaultKind.SILENT),
            fault(3, "bus", FaultKind.REOPENED),
            fault(4, "adc", FaultKind.ANSWERING),
        ]
    )
    assert found == (
        Episode("bus", "broken", 1, 3, "bus broken"),
        Episode("adc", "silent", 2, 4, "adc silent"),
    )


def test_what_repeats_belongs_to_the_episode_that_is_open():
    repeated = [fault(time_ns, "adc", FaultKind.MALFORMED) for time_ns in range(5)]
    (found,) = episodes([*repeated, fault(9, "adc", FaultKind.MALFORMED_OVER)])
    assert (found.begin_ns, found.end_ns) == (0, 9)


def test_a_fault_of_another_source_ends_nothing():
    (found,) = episodes([fault(1, "a", FaultKind.SILENT), fault(2, "b", FaultKind.ANSWERING)])
    assert found.end_ns is None


def test_one_end_may_end_two_kinds():
    kinds = (FaultKind.SILENT, FaultKind.REFUSED)
    found = episodes([*(fault(1, "a", k) for k in kinds), fault(2, "a", FaultKind.ANSWERING)])
    assert [each.end_ns for each in found] == [2, 2]


def test_a_kind_without_an_end_is_a_moment():
    (found,) = episodes([fault(7, "plan", "skipped")])
    assert (found.begin_ns, found.end_ns) == (7, 7)


def test_every_kind_begins_or_ends_something():
    assert {*ENDED_BY, *ENDS} == set(FaultKind)
    assert not ENDS & set(ENDED_BY)
