"""Processes of tests: none outlives its test, and none keeps a test waiting for ever."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any

PATIENCE_S = 60.0
"""How long a process may take to end once it is asked to: a computer may be busy."""


@contextmanager
def child_process(
    command: Sequence[str],
    *,
    stdin: int | IO[Any] | None = None,
    stdout: int | IO[Any] | None = subprocess.PIPE,
    stderr: int | IO[Any] | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """A process while the block lasts; then it is asked to end, and killed where it does not.

    Raises:
        subprocess.TimeoutExpired: it had to be killed.
    """
    with subprocess.Popen(command, stdin=stdin, stdout=stdout, stderr=stderr, text=True) as process:
        try:
            yield process
            process.terminate()
            process.wait(PATIENCE_S)
        finally:
            process.kill()
