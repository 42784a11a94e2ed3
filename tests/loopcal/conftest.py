"""The command as a user runs it, in this process."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from typer.testing import CliRunner, Result

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
