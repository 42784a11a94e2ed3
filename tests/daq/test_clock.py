"""The clocks of a session."""

from __future__ import annotations

import threading
import time

from daq import HostClock, ManualClock


def test_the_host_clock_is_near_utc_and_never_goes_back():
    clock = HostClock()
    assert abs(clock.now_ns() - time.time_ns()) < 1_000_000_000
    times = [clock.now_ns() for _ in range(1000)]
    assert times == sorted(times)


def test_a_step_of_the_systems_clock_changes_nothing(monkeypatch):
    clock = HostClock()
    before = clock.now_ns()
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert 0 <= clock.now_ns() - before < 60_000_000_000


def test_waiting_ends_when_the_event_is_set():
    event = threading.Event()
    event.set()
    assert HostClock().wait(event, 60.0)


def test_a_manual_clock_passes_only_by_waiting():
    clock, event = ManualClock(5), threading.Event()
    assert not clock.wait(event, 3600.0)
    assert clock.now_ns() == 5 + 3600 * 10**9
    event.set()
    assert clock.wait(event, 3600.0)
    assert clock.now_ns() == 5 + 3600 * 10**9
