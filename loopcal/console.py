"""How the command talks to a person: one console for results, one for errors, one way to fail.

Exit codes: 0 done; 1 done, and the answer is bad; 2 wrong input or use; 3 (recordings looked at
or recovered) hopeless: nothing of the recording can be used.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer
from rich.console import Console

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)

DONE = 0
BAD_ANSWER = 1
WRONG_INPUT = 2
HOPELESS = 3


def fail(message: str, code: int = WRONG_INPUT) -> NoReturn:
    """Print one error and end with an exit code, that of wrong input unless told."""
    err.print(f"loopcal: {message}", style="red", markup=False, soft_wrap=True)
    raise typer.Exit(code)


_ROOTS = (
    ("recordings.errors", "RecordingsError"),
    ("solver.errors", "SolverError"),
    ("drivers.errors", "DriverError"),
    ("daq.errors", "DaqError"),
    ("sim_devices.errors", "SimDevicesError"),
)
"""The root exception of every room. A room that no verb has imported cannot have raised."""


@contextmanager
def explained() -> Iterator[None]:
    """Turn the rooms' errors into one message and exit code 2; anything else is a bug and keeps its traceback."""
    try:
        yield
    except FileExistsError as error:
        fail(
            f"{error.filename or error} exists already; choose another name, nothing was overwritten"
        )
    except Exception as error:
        roots = [
            getattr(sys.modules[module], name) for module, name in _ROOTS if module in sys.modules
        ]
        if not isinstance(error, tuple(roots)):
            raise
        fail(str(error))
