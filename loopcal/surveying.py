"""Recordings looked through for `info` and `doctor`: a bar while it takes, a code for the outcome."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from loopcal.console import BAD_ANSWER, DONE, HOPELESS, WRONG_INPUT, err
from loopcal.progress import bar
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
            label = f"reading {path.name}"
            with bar(label) as on_progress:
                found = survey(path, partial(on_progress, label))
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
