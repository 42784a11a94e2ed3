"""Playing a benchmark: many cases in processes of their own, a line a case, to be resumed at any time.

The folder holds ``sealed.jsonl`` (truths, and cases that were left out) and ``answers.jsonl`` (what
the solver said). A case is done when it is in the first, and in the second unless left out.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from loopcal.blind.answering import Answer, answer
from loopcal.blind.grid import Case
from loopcal.blind.making import left_out, make
from loopcal.blind.workers import parallel, sigterm_raised
from sim_devices.errors import SimDevicesError
from solver.errors import SolverError

SEALED = "sealed.jsonl"
ANSWERS = "answers.jsonl"

Played = tuple[dict[str, Any], Answer | None]
"""What is sealed of a case, and the answer unless the case was left out."""


def play(scratch: Path, case: Case) -> Played:
    """Make one case and analyse it, its recording in a folder of its own in ``scratch``."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        recording = Path(folder) / "recording.mcap"
        begin = time.process_time()
        try:
            sealed = make(case, recording)
        except (SimDevicesError, SolverError) as error:
            sealed = left_out(case, f"{type(error).__name__}: {error}")
        told = {**asdict(sealed), "seconds": time.process_time() - begin}
        return told, None if sealed.left_out else answer(recording)


def run(
    cases: Sequence[Case],
    folder: Path,
    *,
    jobs: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
    play: Callable[[Path, Case], Played] = play,
) -> None:
    """Play all of ``cases`` that ``folder`` does not have yet.

    An interrupt or SIGTERM ends it, its processes too; what they were at is played again when it goes on.

    Args:
        cases: to be played.
        folder: of the results; created where there is none.
        jobs: processes; 1 plays them in this one.
        progress: is told how many are done, of how many.
        play: plays one case, with a folder that is gone afterwards; can be pickled where ``jobs`` is not 1.
    """
    folder.mkdir(parents=True, exist_ok=True)
    done = {line["key"] for line in read(folder / SEALED)}
    answered = {line["key"] for line in read(folder / ANSWERS)}
    out = {line["key"] for line in read(folder / SEALED) if line["left_out"]}
    done &= answered | out
    left = [case for case in cases if case.key not in done]
    progress(len(cases) - len(left), len(cases))
    with (
        sigterm_raised(),
        _appended(folder / SEALED) as sealed,
        _appended(folder / ANSWERS) as answers,
        tempfile.TemporaryDirectory() as scratch,
        closing(_played(partial(play, Path(scratch)), left, jobs)) as played,
    ):
        for number, (case, (told, said)) in enumerate(played, start=1):
            if said is not None:
                answers.write(json.dumps({"key": case.key, **said}) + "\n")
                answers.flush()
            sealed.write(json.dumps(told) + "\n")
            sealed.flush()
            progress(len(cases) - len(left) + number, len(cases))


def _played(
    play: Callable[[Case], Played], cases: Sequence[Case], jobs: int
) -> Generator[tuple[Case, Played], None, None]:
    if jobs == 1:
        yield from ((case, play(case)) for case in cases)
    else:
        yield from parallel(play, cases, jobs)


def read(path: Path) -> list[dict[str, Any]]:
    """The lines of a results file, the last of each key; a line cut off in the middle is not one."""
    if not path.exists():
        return []
    lines: dict[str, dict[str, Any]] = {}
    for text in path.read_text("utf-8").splitlines():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue  # the run was ended while it wrote this one; the case is played again
        lines[line["key"]] = line
    return list(lines.values())


def _appended(path: Path) -> TextIO:
    """A results file to write lines to, behind a line that may have been cut off."""
    whole = not path.exists() or path.read_bytes()[-1:] in (b"", b"\n")
    file = path.open("a", encoding="utf-8")
    if not whole:
        file.write("\n")
    return file
