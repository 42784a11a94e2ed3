"""Lines on standard input renew an arming; nothing else does."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator

import pytest

from daq import Arming, ManualClock, Phase, Progress
from loopcal.capturing import Renewals, View
from recordings.events import SessionState


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The writing end of standard input."""
    reading, writing = os.pipe()
    with os.fdopen(reading) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield writing


def test_a_line_renews_and_its_beginning_does_not(typed: int) -> None:
    renewals = Renewals()
    assert not renewals.came()
    os.write(typed, b"yes")
    assert not renewals.came()
    os.write(typed, b"\n")
    assert renewals.came()
    assert not renewals.came()
    os.close(typed)
    assert not renewals.came()
    assert not renewals.came()


def test_no_input_renews_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for stdin in (io.StringIO("\n\n"), None):
        monkeypatch.setattr(sys, "stdin", stdin)
        assert not Renewals().came()


def test_the_view_renews_while_it_shows(typed: int) -> None:
    clock = ManualClock()
    arming = Arming(clock, 10.0)
    arming.grant()
    with View(arming) as view:
        clock.advance(9.0)
        view.show(progress(arming))
        assert arming.left_s == pytest.approx(1.0)
        os.write(typed, b"\n")
        view.show(progress(arming))
        assert arming.left_s == pytest.approx(10.0)
    os.close(typed)


def progress(arming: Arming) -> Progress:
    return Progress(
        phase=Phase.MOVING,
        stop=1,
        stops=3,
        dwells=0,
        elapsed_s=1.0,
        channels=(),
        faults=0,
        latest_fault=None,
        hint="",
        state=SessionState.MOVING,
        armed_s=arming.left_s,
    )
