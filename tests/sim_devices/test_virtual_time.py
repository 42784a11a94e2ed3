"""Virtual time: it passes when it is waited for, and calls are made at their moments."""

from __future__ import annotations

import threading
import time

import pytest

from sim_devices.virtual_time import START_NS, VirtualClock, time_is


def test_time_passes_only_when_it_is_told_to() -> None:
    clock = VirtualClock()
    assert (clock.now_ns(), clock.time_s) == (START_NS, 0.0)
    clock.advance(1.5)
    assert clock.now_ns() == START_NS + 1_500_000_000
    assert clock.monotonic() == 1.5


def test_calls_come_at_their_times_in_order_and_no_more_after_the_block() -> None:
    clock, seen = VirtualClock(), []
    with (
        clock.calling(0.25, lambda time_s: seen.append(("a", time_s))),
        clock.calling(0.5, lambda time_s: seen.append(("b", time_s))),
    ):
        clock.advance(0.3)
        clock.advance(0.7)
    clock.advance(1.0)
    assert seen == [("a", 0.25), ("a", 0.5), ("b", 0.5), ("a", 0.75), ("a", 1.0), ("b", 1.0)]


def test_a_rest_of_a_timeout_below_the_resolution_gets_on() -> None:
    clock = VirtualClock()
    clock.advance(0.25)
    clock.advance(1e-17)
    assert clock.now_ns() == START_NS + 250_000_001
    clock.advance(0.0)
    clock.advance(-1.0)
    assert clock.now_ns() == START_NS + 250_000_001


def test_waiting_for_an_event_passes_the_time_unless_it_is_set() -> None:
    clock, event = VirtualClock(), threading.Event()
    assert not clock.wait(event, 2.0)
    event.set()
    assert clock.wait(event, 2.0)
    assert clock.time_s == 2.0


def test_the_time_of_the_process_is_virtual_inside_and_real_again_outside() -> None:
    real = time.monotonic, time.sleep, time.monotonic_ns
    clock = VirtualClock()
    with time_is(clock):
        time.sleep(3600.0)
        assert time.monotonic() == 3600.0
        assert time.monotonic_ns() == 3_600_000_000_000
    assert (time.monotonic, time.sleep, time.monotonic_ns) == real


def test_python_can_times_its_waits_by_it_too() -> None:
    import can

    bus = can.Bus(interface="virtual", channel="virtual-time")
    clock = VirtualClock()
    bus._recv_internal = lambda timeout: (clock.advance(timeout), (None, False))[1]  # type: ignore[method-assign]
    try:
        with time_is(clock):
            assert bus.recv(1.0) is None
    finally:
        bus.shutdown()
    assert clock.time_s == pytest.approx(1.0)
