"""What an absent port costs: attempts after growing delays, and few turns in between.

Time passes only where the outage waits, so turns and attempts are counted and not timed.
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from drivers.errors import BusOff, LinkBroken, PortNotFound
from drivers.outage import Outage
from drivers.tally import Tally
from drivers.waiting import LONGEST_WAIT_S
from recordings.faults import FaultKind


class Port:
    """Counts how often it is opened; says when."""

    def __init__(self, clock) -> None:
        self.clock = clock
        self.plugged = False
        self.opened_s: list[float] = []

    def open(self) -> None:
        self.opened_s.append(self.clock.now_ns() / 1e9)
        if not self.plugged:
            raise PortNotFound("not there")

    def close(self) -> None: ...


class Waiting:
    """The event that ends a wait: it never comes, and the clock moves on instead."""

    def __init__(self, clock) -> None:
        self.clock = clock

    def wait(self, timeout_s: float) -> bool:
        self.clock.advance(timeout_s)
        return False


@pytest.fixture
def port(clock) -> Port:
    return Port(clock)


@pytest.fixture
def outage(port, clock) -> Outage:
    return Outage("bus", port, [Tally()], clock, Waiting(clock))


def serve(outage: Outage, clock, seconds: float) -> int:
    """Serve an outage for some time; the number of turns."""
    until_ns = clock.now_ns() + round(seconds * 1e9)
    turns = 0
    while outage.lasts and clock.now_ns() < until_ns:
        outage.serve(0, timeout_s=1.0)
        turns += 1
    return turns


def delays(port: Port, since_s: float) -> list[float]:
    times = [since_s, *port.opened_s]
    return [round(b - a, 2) for a, b in pairwise(times)]


def test_an_absent_port_is_tried_after_growing_delays_and_costs_few_turns(outage, port, clock):
    since_s = clock.now_ns() / 1e9
    outage.begin(LinkBroken("gone"), sampling=True)
    turns = serve(outage, clock, 60.0)
    assert delays(port, since_s)[:6] == [0.25, 0.5, 1.0, 2.0, 4.0, 4.0]
    assert len(port.opened_s) == 18
    assert turns <= 60.0 / LONGEST_WAIT_S + 2 * len(port.opened_s)


def test_a_port_that_breaks_again_soon_goes_on_with_its_delay(outage, port, clock):
    port.plugged = True
    since_s = clock.now_ns() / 1e9
    for _ in range(5):
        outage.begin(BusOff("off"), sampling=False)
        serve(outage, clock, 10.0)
        assert not outage.lasts
    assert delays(port, since_s) == [0.25, 0.5, 1.0, 2.0, 4.0]


def test_a_port_that_was_steady_is_tried_soon_again(outage, port, clock):
    port.plugged = True
    for _ in range(3):
        began_s = clock.now_ns() / 1e9
        outage.begin(LinkBroken("gone"), sampling=False)
        serve(outage, clock, 10.0)
        assert port.opened_s[-1] - began_s == pytest.approx(0.25, abs=0.01)
        clock.advance(6.0)


def test_what_went_away_is_told(outage, clock):
    assert outage.begin(LinkBroken("gone"), sampling=False).kind == FaultKind.BROKEN
    assert outage.begin(BusOff("off"), sampling=False).kind == FaultKind.BUS_OFF
