"""Many seeded runs on all cores, with a progress bar on the terminal."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from rich.console import Console
from rich.progress import track

Result = TypeVar("Result")

console = Console(width=None if sys.stdout.isatty() else 110)


def runs(work: Callable[[int], Result], count: int, title: str) -> list[Result]:
    """``work(seed)`` for seeds 0 to count - 1, in order; ``work`` is a function of a module.

    Workers start afresh with one thread each for linear algebra: runs side by side are faster
    than matrices in parallel.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(mp_context=context) as pool:
        results = pool.map(work, range(count), chunksize=4)
        return list(track(results, title, total=count, console=Console(stderr=True)))
