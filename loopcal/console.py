"""How the command talks to a person: one console for results, one for errors, one way to fail.

Exit codes: 0 done; 1 done, and the answer is bad; 2 wrong input or use.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer
from rich.console import Console

from recordings.errors import RecordingsError

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)

BAD_ANSWER = 1
WRONG_INPUT = 2


def fail(message: str) -> NoReturn:
    """Print one error and end with the exit code of wrong input."""
    err.print(f"loopcal: {message}", style="red", markup=False, soft_wrap=True)
    raise typer.Exit(WRONG_INPUT)


@contextmanager
def explained() -> Iterator[None]:
    """Turn the rooms' errors into one message and exit code 2; anything else is a bug and keeps its traceback."""
    from daq.errors import DaqError
    from drivers.errors import DriverError
    from sim_devices.errors import SimDevicesError
    from solver.errors import SolverError

    try:
        yield
    except (RecordingsError, SolverError, DriverError, DaqError, SimDevicesError) as error:
        fail(str(error))
    except FileExistsError as error:
        fail(
            f"{error.filename or error} exists already; choose another name, nothing was overwritten"
        )
