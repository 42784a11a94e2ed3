"""The bar that shows how far a verb has come. Owns its look; what counts as done, its callers know."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from loopcal.console import err


@contextmanager
def bar(label: str) -> Iterator[Callable[[str, float], None]]:
    """A bar on the terminal, gone when done; elsewhere nothing.

    Gives what is to be called with the step under way and the share that is done, 0 to 1.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as progress:
        task = progress.add_task(label, total=1.0)
        yield lambda step, share: progress.update(task, description=step, completed=share)
