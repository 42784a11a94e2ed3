"""Stopping a session: a flag that a signal handler may set, and the signals that set it.

Signals ask a session to stop, and never tear it away from what it does. An event of `threading` will
not do: its lock may be held by the very code that the handler interrupts, which then waits for itself.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Stop:
    """Set once, by anybody at any moment; there is nothing to wait for but the next look at it."""

    def __init__(self) -> None:
        self._asked = False

    def set(self) -> None:
        """Ask for the stop; takes no lock."""
        self._asked = True

    def is_set(self) -> bool:
        """Whether somebody has asked."""
        return self._asked


@contextmanager
def signals_set(stop: Stop) -> Iterator[None]:
    """Let signals set ``stop``: an exception in the middle of a command would be unsafe."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.set()

    numbers = [signal.SIGINT, signal.SIGTERM]
    # A closed terminal hangs up, where there is such a signal, and unless `nohup` has said otherwise.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
