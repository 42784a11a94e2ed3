"""Every reader of outside data under changed inputs, for as long as is wished:

    python benchmarks/fuzz.py --minutes 10 [--only NAME ...] [--seed N] [--out FOLDER]

What is fuzzed, and what must hold, is the table `tests/fuzzing/targets.py`. Inputs that
reach lines of this program that none before did join those that further ones are made from.
Each input has five seconds; one that takes longer, raises what its reader does not document, or
needs more memory than a gibibyte is written to FOLDER, with what it raised. The run
goes on, and ends with exit code 1.

One process, changes by `tests/fuzzing/mutation.py`, coverage by `sys.settrace`: slow, but it
needs nothing to be installed, and repeats itself by its seed.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import signal
import sys
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any

from monte_carlo import console
from rich.progress import Progress
from rich.table import Table

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests.fuzzing.mutation import flipped, mutated  # noqa: E402
from tests.fuzzing.target import Target  # noqa: E402
from tests.fuzzing.targets import TARGETS  # noqa: E402

LONGEST_S = 5.0
MOST_BYTES = 1 << 30
SLICE_S = 5.0
ROOMS = tuple(f"{ROOT}/{room}/" for room in ("recordings", "drivers", "daq", "solver"))


class TooLong(Exception):
    """An input took longer than `LONGEST_S`."""


class Coverage:
    """Lines of our own rooms that were ever reached."""

    def __init__(self) -> None:
        self._seen: set[tuple[str, int]] = set()
        self._new = 0

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Take note of the lines that run."""
        sys.settrace(self._call)
        try:
            yield
        finally:
            sys.settrace(None)

    def grown(self) -> bool:
        """Whether a line was new since the last call."""
        new, self._new = self._new, 0
        return new > 0

    @property
    def lines(self) -> int:
        """How many lines."""
        return len(self._seen)

    def _call(self, frame: FrameType, event: str, arg: Any) -> Any:
        return self._line if frame.f_code.co_filename.startswith(ROOMS) else None

    def _line(self, frame: FrameType, event: str, arg: Any) -> Any:
        at = (frame.f_code.co_filename, frame.f_lineno)
        if at not in self._seen:
            self._seen.add(at)
            self._new += 1
        return self._line


class Campaign:
    """The fuzzing of one target: its inputs so far, and what was found."""

    def __init__(self, target: Target, random: Random, out: Path) -> None:
        self.target = target
        self.inputs: list[bytes] = list(target.seeds())
        self.tried = 0
        self.slowest_s = 0.0
        self.coverage = Coverage()
        self.findings: Counter[str] = Counter()
        self._seeds = tuple(self.inputs)
        self._random = random
        self._out = out
        for seed in self.inputs:
            with self.coverage.watched():
                target.check(seed)
        self.coverage.grown()

    def run(self, until: float) -> None:
        """Try inputs until the monotonic time ``until``."""
        while time.monotonic() < until:
            if self.target.check_flips is not None and self._random.random() < 0.3:
                seed = self._random.choice(self._seeds)
                other = flipped(seed, self._random)
                self._try(other, lambda: self.target.check_flips(seed, other))  # noqa: B023
            else:
                data = mutated(self.target, self.inputs, self._random)
                self._try(data, lambda: self.target.check(data))  # noqa: B023

    def _try(self, data: bytes, check: Any) -> None:
        self.tried += 1
        began = time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
        try:
            with self.coverage.watched():
                check()
        except Exception as error:  # noqa: BLE001 - whatever gets out is what is looked for
            self._found(data, error)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        self.slowest_s = max(self.slowest_s, time.perf_counter() - began)
        if self.coverage.grown():
            self.inputs.append(data)

    def _found(self, data: bytes, error: Exception) -> None:
        """Keep an input the first time that something fails in this way at this place."""
        where = [
            f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(str(ROOT))
        ]
        place = f"{Path(where[-1].filename).name}:{where[-1].lineno}" if where else "?"
        kind = f"{type(error).__name__} at {place}"
        self.findings[kind] += 1
        if self.findings[kind] > 1:
            return
        self._out.mkdir(parents=True, exist_ok=True)
        name = f"{self.target.name}-{hashlib.sha256(data).hexdigest()[:12]}"
        (self._out / name).write_bytes(data)
        text = "".join(traceback.format_exception(error))
        (self._out / f"{name}.txt").write_text(f"{kind}\n\n{text}", errors="backslashreplace")


def _too_long(number: int, frame: FrameType | None) -> None:
    raise TooLong(f"no answer within {LONGEST_S} s")


def _limit_memory() -> None:
    """Let what asks for more than `MOST_BYTES` beyond what is there fail."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))


def _chosen(names: Sequence[str]) -> list[Target]:
    known = {target.name: target for target in TARGETS}
    for name in names:
        if name not in known:
            raise SystemExit(f"there is no target '{name}'; targets: {', '.join(known)}")
    return [known[name] for name in names] or list(TARGETS)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=1.0, help="how long, for all targets")
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="some targets only")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("fuzz-findings"), help="for what is found")
    given = parser.parse_args()
    signal.signal(signal.SIGALRM, _too_long)
    warnings.simplefilter("error")
    campaigns = [
        Campaign(target, Random(f"{given.seed} {target.name}"), given.out)
        for target in _chosen(given.only)
    ]
    threads = threading.active_count()
    _limit_memory()
    began = time.monotonic()
    end = began + 60 * given.minutes
    slice_s = min(SLICE_S, 60 * given.minutes / len(campaigns))
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("", total=60 * given.minutes)
        while time.monotonic() < end:
            for campaign in campaigns:
                bar.update(task, description=campaign.target.name)
                campaign.run(min(end, time.monotonic() + slice_s))
                bar.update(task, completed=time.monotonic() - began)
    table = Table("target", "inputs tried", "kept", "lines reached", "slowest", "findings")
    for campaign in campaigns:
        table.add_row(
            campaign.target.name,
            f"{campaign.tried:,}",
            str(len(campaign.inputs)),
            str(campaign.coverage.lines),
            f"{campaign.slowest_s:.2f} s",
            "\n".join(f"{n} x {kind}" for kind, n in campaign.findings.items()),
        )
    console.print(table)
    if threading.active_count() > threads:
        console.print(f"{threading.active_count() - threads} threads were left running")
    found = any(campaign.findings for campaign in campaigns) or threading.active_count() > threads
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
