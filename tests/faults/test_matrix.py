"""Every fault with every driver: noticed in time, recorded with its end, every loss accounted for.

The sessions run once for the whole module; each cell of the matrix is a test.
"""

from __future__ import annotations

import functools

import pytest

from drivers import driver_names
from drivers.detection import DETECTION, Detected, Trouble
from recordings.faults import ENDED_BY, FaultKind
from tests.faults.bench import CASES, run
from tests.faults.matrix import PAGE, SCRIPTS, cells, measure, page

measured = functools.cache(measure)
CELLS = [pytest.param(*each, id=f"{each[0]}: {each[1]}") for each in cells()]
UNASKED = (Trouble.DUPLICATE,)
"""Troubles with readings beyond those that were asked for."""

UNTOLD = (("ascii-adc", Trouble.CHECKSUM),)
"""Where damaged counters look like good ones: nothing protects a line of text."""


@pytest.mark.parametrize(("driver", "trouble"), CELLS)
def test_a_fault_is_noticed_in_time_and_over_in_the_end(driver: str, trouble: Trouble) -> None:
    cell = measured(driver, trouble)
    assert cell.kind is not None, cell.outcome.faults
    assert cell.detected_s <= cell.promise.within_s, cell.outcome.faults
    lasting = {e.kind for e in cell.outcome.episodes if e.kind in ENDED_BY and e.end_ns is None}
    # A digit changed on the line of an slcan adapter can make an emergency of another frame.
    made_up = {FaultKind.EMERGENCY} if trouble is Trouble.CHECKSUM else set()
    assert lasting <= made_up
    before = [f for f in cell.outcome.faults if cell.outcome.seconds(f.time_ns) < 1.0]
    assert before == []


@pytest.mark.parametrize(("driver", "trouble"), CELLS)
def test_no_reading_is_unaccounted_for(driver: str, trouble: Trouble) -> None:
    cell = measured(driver, trouble)
    ledger = cell.outcome.ledger
    assert ledger.unaccounted == 0
    assert ledger.received == len(cell.outcome.readings)
    if (driver, trouble) not in UNTOLD and trouble not in UNASKED:
        # The schedule says how many there must be, whatever the driver has counted; a device
        # that samples by its own clock begins at its own time, and at a restart anew.
        slack = 3 if CASES[driver].streams else 1
        assert abs(ledger.expected - cell.outcome.instants) <= slack
    end_s = SCRIPTS[trouble].end_s
    assert any(time_s > end_s for time_s, _ in cell.outcome.readings)


def test_what_was_dropped_on_a_bus_is_what_the_ledger_says() -> None:
    outcome = run("canopen-encoder", "at 0.5 s drop device 20 % for 3 s", 5.0)
    assert outcome.dropped > 30
    assert outcome.ledger.lost_in_gaps + outcome.ledger.dropped_by_device == outcome.dropped


def test_every_driver_is_in_the_matrix_and_in_the_table() -> None:
    assert set(CASES) == set(DETECTION)
    assert {name.partition(" ")[0] for name in DETECTION} == set(driver_names())


@pytest.mark.parametrize("driver", DETECTION)
def test_what_cannot_occur_says_why(driver: str) -> None:
    assert set(DETECTION[driver]) == set(Trouble)
    for promise in DETECTION[driver].values():
        if isinstance(promise, Detected):
            assert promise.within_s <= 1.5
            assert promise.kinds
        else:
            assert len(promise) > 20


@pytest.mark.parametrize("driver", CASES)
def test_a_session_without_faults_has_none(driver: str) -> None:
    outcome = run(driver, "", 3.0)
    assert outcome.faults == ()
    assert outcome.ledger.received == outcome.ledger.expected
    assert abs(outcome.ledger.expected - outcome.instants) <= (3 if CASES[driver].streams else 0)


def test_the_page_is_what_was_measured() -> None:
    assert PAGE.read_text("utf-8") == page({each: measured(*each) for each in cells()}), (
        "docs/fault-matrix.md is old: python -m tests.faults.matrix writes it again"
    )
