"""How a CAN link reports and accounts for a device that falls silent, and a bus that comes and goes.

The device answers in the moment in which it is asked, in the same thread: virtual time passes
between two turns of the link only, so no answer can be late.
"""

from __future__ import annotations

import can
import pytest

from drivers.can_link import CanLink
from drivers.canopen.encoder import Encoder, EncoderOptions
from drivers.driver import DeviceSpec
from recordings.events import Event, Fault, Reading
from recordings.faults import FaultKind

HZ = 100.0
STEP_S = 1 / HZ


class Node:
    """An encoder with fixed PDOs as node 1 of ``bus``: knows no object, answers each SYNC."""

    def __init__(self, bus) -> None:
        self.listens = True
        self._bus = bus
        bus.answer = self._answer

    def _answer(self, message: can.Message) -> None:
        if message.arbitration_id == 0x601:  # "object does not exist"
            self._bus.push(0x581, b"\x80" + bytes(message.data[1:4]) + b"\0\0\2\6")
        elif message.arbitration_id == 0x080 and self.listens:
            self._bus.push(0x181, b"\1\0\0\0")


@pytest.fixture
def node(bus) -> Node:
    return Node(bus)


@pytest.fixture
def link(can_port, channel, clock, bus, node):
    options = EncoderOptions.model_validate({"node_id": 1})
    device = Encoder(
        DeviceSpec("encoder1", "canopen-encoder", "bus", None, (channel("q1"),), options)
    )
    link = CanLink(can_port, [device], clock, connect=bus.connect)
    link.open()
    link.start(HZ)
    yield link
    link.close()


@pytest.fixture
def run(link, clock):
    """Serves the link for a number of sampling periods."""

    def run(steps: int) -> list[Event]:
        events: list[Event] = []
        for _ in range(steps):
            events.extend(link.pump(0.0))
            clock.advance(STEP_S)
        return events

    return run


def faults(events: list[Event]) -> list[tuple[str, FaultKind]]:
    return [(event.source, event.kind) for event in events if isinstance(event, Fault)]


def test_a_silent_encoder_is_reported_once_and_when_it_is_back(node, run):
    node.listens = False
    events = run(300)
    (silent,) = (event for event in events if isinstance(event, Fault))
    assert (silent.source, silent.kind) == ("encoder1", FaultKind.SILENT)
    assert "node 1" in silent.text
    node.listens = True
    events = run(300)
    assert faults(events) == [("encoder1", FaultKind.ANSWERING)]
    assert sum(isinstance(event, Reading) for event in events) == 300


def test_an_unplugged_bus_is_reported_reopened_and_accounted_for(link, bus, run):
    events = run(50)
    bus.plugged = False
    events += run(1000)
    bus.plugged = True
    bus.sent.clear()
    events += run(500)
    link.stop()
    events += link.pump(0.0)

    assert faults(events) == [("bus", FaultKind.BROKEN), ("bus", FaultKind.REOPENED)]
    assert bus.attempts == 1 + 6  # after 0.25, 0.5, 1, 2, 4 and 4 s
    started_again = [m for m in bus.sent if m.arbitration_id == 0x000 and m.data == b"\1\1"]
    assert len(started_again) == 1
    received = sum(isinstance(event, Reading) for event in events)
    losses = link.losses()["q1"]
    assert losses.expected == 1550
    assert losses.expected - received == losses.dropped_by_device + losses.lost_in_gaps
    assert losses.dropped_by_device == 0
    assert losses.gaps == 1
    assert 1000 <= losses.lost_in_gaps <= 1200


def test_commands_to_an_absent_bus_fail_at_once(link, bus):
    bus.plugged = False
    link.pump(0.0)
    (status,) = link.check()
    assert not status.answers
    assert "being opened again" in status.problem
