"""Signals that ask a session to stop, in whatever they interrupt."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import pytest

from daq import HostClock, Stop
from daq.clock import LOOK_S
from daq.stop import signals_set


@contextmanager
def struck_at_every_line() -> Iterator[None]:
    """Inside, SIGTERM comes before each line that Python code runs; locks cannot be had twice."""

    def strike(frame: FrameType, event: str, argument: object) -> object:
        handler = signal.getsignal(signal.SIGTERM)
        if callable(handler):
            handler(signal.SIGTERM, frame)
        return strike

    before = sys.gettrace()
    sys.settrace(strike)
    try:
        yield
    finally:
        sys.settrace(before)


def test_a_signal_is_no_danger_to_the_wait_that_it_interrupts() -> None:
    stop, clock = Stop(), HostClock()
    with signals_set(stop), struck_at_every_line():
        assert clock.wait(stop, 60.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_set_it_and_handlers_are_put_back(number: signal.Signals) -> None:
    before, stop = signal.getsignal(number), Stop()
    with signals_set(stop):
        os.kill(os.getpid(), number)
        assert HostClock().wait(stop, 60.0)
    assert signal.getsignal(number) is before


def test_a_wait_looks_often_enough() -> None:
    clock, stop = HostClock(), Stop()
    setter = threading.Timer(2 * LOOK_S, stop.set)
    setter.start()
    assert clock.wait(stop, 60.0)
    setter.join()


def test_another_thread_leaves_the_handlers_alone() -> None:
    before, seen = signal.getsignal(signal.SIGINT), []

    def look() -> None:
        with signals_set(Stop()):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [before]
