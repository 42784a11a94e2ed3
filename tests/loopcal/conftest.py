"""The command as a user runs it, in this process; and sessions over wires on a computer that may be busy."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from daq import CaptureSummary, Ending
from loopcal.cli import app


@pytest.fixture
def loopcal() -> Callable[..., Result]:
    """Run `loopcal` with these words; a traceback is a failure of the test."""

    def run(*words: object) -> Result:
        outcome = CliRunner().invoke(app, [str(word) for word in words])
        if outcome.exception is not None and not isinstance(outcome.exception, SystemExit):
            raise outcome.exception
        return outcome

    return run


_ATTEMPTS = 8
_HELD_UP_S = 30.0


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """The text of a rig whose drives and session go on when the computer stands still for a while.

    For tests that are not about supervision, which ends a session after a second.
    """
    monkeypatch.setattr("daq.guard.LONGEST_LAPSE_S", _HELD_UP_S)
    monkeypatch.setattr("daq.guard.VOUCHED_S", _HELD_UP_S)
    drive = re.compile(r'(driver = "canopen-joint"\n(?:\w.*\n)*?options = \{ )')

    def changed(text: str) -> str:
        text, drives = drive.subn(rf"\g<1>heartbeat_timeout_s = {_HELD_UP_S:g}, ", text)
        if drives:
            assert "[interlocks]" not in text
            text = text.replace("[plan]", f"[interlocks]\nsilence_s = {_HELD_UP_S:g}\n\n[plan]", 1)
        return text

    return changed


@pytest.fixture
def until_complete(tmp_path: Path) -> Callable[[Callable[[Path], CaptureSummary]], CaptureSummary]:
    """Run a driven session, given a file to write, until it is complete, eight times at most.

    A computer that stands still may end such a session, as it should: the drives were not
    supervised. That is tested elsewhere.
    """

    def run(session: Callable[[Path], CaptureSummary]) -> CaptureSummary:
        for attempt in range(_ATTEMPTS):
            summary = session(tmp_path / f"session-{attempt}.mcap")
            if summary.ending is Ending.COMPLETE:
                break
        return summary

    return run
