"""Processes that play cases, and end with the one that started them, however that one ends.

Each worker holds one end of a pipe whose other end is open in the starting process alone: when that
end is closed, on purpose or because the process is no more, the worker ends where it is. So an
interrupt, SIGTERM and even SIGKILL of the benchmark leave nobody at work behind.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from types import FrameType
from typing import TypeVar

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_AHEAD = 2
"""Cases a process has waiting: few, so that an interrupted run loses little."""

_Case = TypeVar("_Case")
_Played = TypeVar("_Played")


def parallel(
    play: Callable[[_Case], _Played], cases: Sequence[_Case], jobs: int
) -> Iterator[tuple[_Case, _Played]]:
    """``play`` of every case, in ``jobs`` processes, in the order in which they end.

    Args:
        play: can be pickled.
        cases: likewise.
        jobs: processes, each computing in one thread: several would fight over the same cores.

    Closed before its end, it ends the processes where they are.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    held, lifeline = multiprocessing.Pipe(duplex=False)
    todo, waiting = iter(cases), dict[Future[_Played], _Case]()
    try:
        with ProcessPoolExecutor(
            jobs, multiprocessing.get_context("spawn"), _tied, (held,)
        ) as pool:
            try:
                while True:
                    while len(waiting) < _AHEAD * jobs and (case := next(todo, None)) is not None:
                        waiting[pool.submit(play, case)] = case
                    if not waiting:
                        return
                    for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                        yield waiting.pop(future), future.result()
            except BaseException:
                lifeline.close()
                raise
    finally:
        lifeline.close()
        held.close()
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def sigterm_raised() -> Iterator[None]:
    """SIGTERM raises SystemExit(143) here, so that what is open is closed; in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, on_signal)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _tied(lifeline: Connection) -> None:
    """Let this worker end with ``lifeline``; an interrupt from the terminal is the starter's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with suppress(EOFError, OSError):
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()
