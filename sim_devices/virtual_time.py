"""Time that passes only when it is told to, or waited for: minutes of a bench in a moment.

    clock = VirtualClock()
    with time_is(clock):
        time.sleep(60)          # returns at once; the clock has moved on by a minute

Made for one thread. Waiting on locks, events and queues of `threading` is not virtual: what
waits there waits for another thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol
from unittest.mock import patch

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND


class Flag(Protocol):
    """What a session waits for."""

    def is_set(self) -> bool:
        """Whether it has been set."""
        ...


class VirtualClock:
    """A clock that moves by hand. It is a clock as links and sessions want one.

    Attributes:
        time_s: seconds since the clock was made.
    """

    def __init__(self) -> None:
        self._elapsed_ns = 0
        self._every: list[tuple[int, Callable[[float], None]]] = []

    @property
    def time_s(self) -> float:
        """Seconds since the clock was made."""
        return self._elapsed_ns / SECOND

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch, beginning with a fixed day of 2023."""
        return START_NS + self._elapsed_ns

    def monotonic(self) -> float:
        """Seconds since the clock was made, as `time.monotonic` gives them."""
        return self.time_s

    def advance(self, seconds: float) -> None:
        """Let ``seconds`` pass; whatever is to be called meanwhile is called at its time.

        Any time above 0 is at least a nanosecond: who waits for the rest of a timeout gets on.
        """
        until_ns = self._elapsed_ns + round(max(seconds, 0.0) * SECOND)
        if seconds > 0.0 and until_ns == self._elapsed_ns:
            until_ns += 1
        while self._every:
            due_ns = min(self._next_ns(period_ns) for period_ns, _ in self._every)
            if due_ns > until_ns:
                break
            self._elapsed_ns = due_ns
            for period_ns, call in list(self._every):
                if due_ns % period_ns == 0:
                    call(self.time_s)
        self._elapsed_ns = until_ns

    def wait(self, flag: Flag, timeout_s: float) -> bool:
        """Let ``timeout_s`` pass at once, unless ``flag`` is set already; say whether it is."""
        if not flag.is_set():
            self.advance(timeout_s)
        return flag.is_set()

    @contextmanager
    def calling(self, period_s: float, call: Callable[[float], None]) -> Iterator[None]:
        """Inside, ``call`` gets the time [s] every ``period_s``."""
        entry = (round(period_s * SECOND), call)
        self._every.append(entry)
        try:
            yield
        finally:
            self._every.remove(entry)

    def _next_ns(self, period_ns: int) -> int:
        return (self._elapsed_ns // period_ns + 1) * period_ns


@contextmanager
def time_is(clock: VirtualClock) -> Iterator[VirtualClock]:
    """Inside, `time.monotonic` and `time.sleep` go by ``clock``, and so does what waits with them."""
    with ExitStack() as stack:
        stack.enter_context(patch.object(time, "monotonic", clock.monotonic))
        stack.enter_context(patch.object(time, "monotonic_ns", lambda: clock.now_ns() - START_NS))
        stack.enter_context(patch.object(time, "sleep", clock.advance))
        if "can.bus" in sys.modules:
            # python-can measures its timeouts by the wall clock, which it imports by name.
            stack.enter_context(patch.object(sys.modules["can.bus"], "time", clock.monotonic))
        yield clock
