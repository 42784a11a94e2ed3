"""Playing a benchmark: many cases in processes of their own, a line a case, to be resumed at any time.

The folder holds ``sealed.jsonl`` (truths, and cases that were left out) and ``answers.jsonl`` (what
the solver said). A case is done when it is in the first, and in the second unless left out.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from loopcal.blind.answering import Answer, answer
from loopcal.blind.grid import Case
from loopcal.blind.making import left_out, make
from sim_devices.errors import SimDevicesError
from solver.errors import SolverError

SEALED = "sealed.jsonl"
ANSWERS = "answers.jsonl"

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_AHEAD = 2
"""Cases a process has waiting: few, so that an interrupted run loses little."""


def play(case: Case) -> tuple[dict[str, Any], Answer | None]:
    """Make one case and analyse it: what is sealed, and the answer unless the case was left out."""
    with tempfile.TemporaryDirectory() as folder:
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
) -> None:
    """Play all of ``cases`` that ``folder`` does not have yet.

    Args:
        cases: to be played.
        folder: of the results; created where there is none.
        jobs: processes; 1 plays them in this one.
        progress: is told how many are done, of how many.
    """
    folder.mkdir(parents=True, exist_ok=True)
    done = {line["key"] for line in read(folder / SEALED)}
    answered = {line["key"] for line in read(folder / ANSWERS)}
    out = {line["key"] for line in read(folder / SEALED) if line["left_out"]}
    done &= answered | out
    left = [case for case in cases if case.key not in done]
    progress(len(cases) - len(left), len(cases))
    with _appended(folder / SEALED) as sealed, _appended(folder / ANSWERS) as answers:
        played = map(_alone, left) if jobs == 1 else _parallel(left, jobs)
        for number, (case, told, said) in enumerate(played, start=1):
            if said is not None:
                answers.write(json.dumps({"key": case.key, **said}) + "\n")
                answers.flush()
            sealed.write(json.dumps(told) + "\n")
            sealed.flush()
            progress(len(cases) - len(left) + number, len(cases))


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


_Played = tuple[Case, dict[str, Any], Answer | None]


def _alone(case: Case) -> _Played:
    return (case, *play(case))


def _parallel(cases: Sequence[Case], jobs: int) -> Iterator[_Played]:
    """In the order in which they end."""
    # Each process computes in one thread: several would fight over the same cores.
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    waiting: set[Future[_Played]] = set()
    try:
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
            todo = iter(cases)
            while True:
                while len(waiting) < _AHEAD * jobs and (case := next(todo, None)) is not None:
                    waiting.add(pool.submit(_alone, case))
                if not waiting:
                    return
                ended, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in ended:
                    yield future.result()
    finally:
        for future in waiting:
            future.cancel()
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
