"""The command as a user runs it, in this process; and sessions over wires on a computer that may be busy."""

from __future__ import annotations

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


@pytest.fixture
def until_complete(tmp_path: Path) -> Callable[[Callable[[Path], CaptureSummary]], CaptureSummary]:
    """Run a driven session, given a file to write, until it is complete, eight times at most.

    A computer that stands still for a second ends such a session, as it should: the drives were
    not supervised. That is tested elsewhere.
    """

    def run(session: Callable[[Path], CaptureSummary]) -> CaptureSummary:
        for attempt in range(_ATTEMPTS):
            summary = session(tmp_path / f"session-{attempt}.mcap")
            if summary.ending is Ending.COMPLETE:
                break
        return summary

    return run
