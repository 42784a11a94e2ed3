"""Recordings looked through for `info` and `doctor`: a bar while it takes, a code for the outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from loopcal.console import BAD_ANSWER, DONE, HOPELESS, WRONG_INPUT, err
from recordings.errors import HopelessRecording, NothingReadable, RecordingsError
from recordings.survey import Survey, survey


def look_through(paths: Sequence[Path], show: Callable[[Survey], bool]) -> int:
    """Survey each recording and show it; one that cannot be read does not keep the others back.

    Args:
        paths: the recordings.
        show: shows one, and says whether it is well.

    Returns:
        the exit code, that of the worst of them.
    """
    worst = DONE
    for path in paths:
        try:
            with bar(f"reading {path.name}") as on_progress:
                found = survey(path, on_progress)
            code = DONE if show(found) else BAD_ANSWER
            if found.hopeless:
                code = HOPELESS
        except RecordingsError as error:
            err.print(f"loopcal: {error}", style="red", markup=False, soft_wrap=True)
            code = code_of(error)
        worst = max(worst, code)
    return worst


def code_of(error: RecordingsError) -> int:
    """The exit code that an error stands for."""
    return HOPELESS if isinstance(error, NothingReadable | HopelessRecording) else WRONG_INPUT


@contextmanager
def bar(label: str) -> Iterator[Callable[[float], None]]:
    """A bar on the terminal, gone when done; gives what takes the share done, 0 to 1."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as progress:
        task = progress.add_task(label, total=1.0)
        yield lambda share: progress.update(task, completed=share)
