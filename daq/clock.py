"""The time of a session: monotonic, anchored once to UTC, and injected.

A step of the system's clock during a session cannot reorder what was recorded. Waiting
goes through the clock too, so that a test can let hours pass without sleeping.
"""

from __future__ import annotations

import time
from typing import Protocol

SECOND = 1_000_000_000
"""Nanoseconds in a second."""


LOOK_S = 0.02
"""Longest time between two looks at a flag that is waited for [s]."""


class Flag(Protocol):
    """What can be waited for: `daq.Stop`, or an event of `threading`."""

    def is_set(self) -> bool:
        """Whether it has been set."""
        ...


class Clock(Protocol):
    """What a session asks about time."""

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch; never decreases."""
        ...

    def wait(self, flag: Flag, timeout_s: float) -> bool:
        """Wait until ``flag`` is set or ``timeout_s`` has passed; say whether it is set."""
        ...


class HostClock:
    """The host's monotonic clock, anchored to UTC when it is made.

    It goes on while the computer sleeps, where the system has such a clock: whoever supervises
    must notice that.
    """

    def __init__(self) -> None:
        self._anchor_ns = time.time_ns() - _monotonic_ns()

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch, by the monotonic clock."""
        return self._anchor_ns + _monotonic_ns()

    def wait(self, flag: Flag, timeout_s: float) -> bool:
        """Wait until ``flag`` is set, seen within `LOOK_S`, or ``timeout_s`` has passed; say whether it is set."""
        end_s = time.monotonic() + timeout_s
        while not flag.is_set() and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, LOOK_S))
        return flag.is_set()


def _monotonic_ns() -> int:
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    return time.monotonic_ns()


class ManualClock:
    """Time that passes only when it is told to, or waited for: for tests and replays."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch."""
        return self._now_ns

    def advance(self, seconds: float) -> None:
        """Let ``seconds`` pass."""
        self._now_ns += round(seconds * SECOND)

    def wait(self, flag: Flag, timeout_s: float) -> bool:
        """Let ``timeout_s`` pass at once, unless ``flag`` is set already."""
        if not flag.is_set():
            self.advance(timeout_s)
        return flag.is_set()
