"""What is seen in the readings of any driver: stuck, silent and losing channels, restarted devices."""

from __future__ import annotations

import math
import random

import pytest

from drivers.link import Losses
from drivers.watch import WatchedLink, repeats_allowed
from recordings.events import Fault, Reading, ReadingFlag
from recordings.faults import FaultKind

HZ = 100.0
STEP_S = 1 / HZ
REPORTED = "by the link itself"


class Scripted:
    """A link that gives what a test puts into it."""

    name = "bus"

    def __init__(self) -> None:
        self.joints: dict = {}
        self.events: list = []
        self.expected = self.lost = 0

    def start(self, sample_hz: float) -> None: ...

    def stop(self) -> None: ...

    def pump(self, timeout_s: float) -> list:
        events, self.events = self.events, []
        return events

    def losses(self) -> dict:
        return {"q1": Losses(self.expected, 0, self.lost, 0)}


class Session:
    """A watched link with one channel, in virtual time."""

    def __init__(self, clock, channel) -> None:
        self.clock = clock
        self.link = Scripted()
        self.watched = WatchedLink(self.link, [channel], clock)
        self.watched.start(HZ)
        self.faults: list[Fault] = []
        self.sequence = 0
        self.random = random.Random(1)

    def pump(self) -> None:
        self.clock.advance(STEP_S)
        came = self.watched.pump(0.0)
        self.faults += [e for e in came if isinstance(e, Fault) and e.text != REPORTED]

    def read(self, raw: int | None = None, flags: ReadingFlag = ReadingFlag.NONE) -> None:
        self.sequence += 1
        raw = round(self.random.gauss(500, 2)) if raw is None else raw
        reading = Reading("q1", self.clock.now_ns(), raw, sequence=self.sequence, flags=flags)
        self.link.events.append(reading)
        self.pump()

    def report(self, source: str, kind: FaultKind) -> None:
        self.link.events.append(Fault(self.clock.now_ns(), source, kind, REPORTED))

    @property
    def kinds(self) -> list[str]:
        return [fault.kind for fault in self.faults]


@pytest.fixture
def session(clock, channel) -> Session:
    return Session(clock, channel("q1", noise=2.0, device="adc"))


@pytest.mark.parametrize(
    ("noise", "allowed"), [(0.0, math.inf), (0.05, math.inf), (1.0, 29), (10.0, 9)]
)
def test_how_often_a_count_may_repeat_follows_from_the_noise(noise, allowed):
    assert repeats_allowed(noise) == allowed


def test_a_channel_that_repeats_one_count_is_stuck_after_a_second(session):
    for _ in range(50):
        session.read()
    for _ in range(99):
        session.read(700)
    assert session.faults == []
    for _ in range(50):
        session.read(700)
    (stuck,) = session.faults
    assert (stuck.source, stuck.kind) == ("q1", FaultKind.STUCK)
    assert "the count 700" in stuck.text
    session.read()
    session.read()
    assert session.kinds == [FaultKind.STUCK, FaultKind.CHANGING]


def test_a_channel_without_noise_may_stand_still_for_ever(clock, channel):
    session = Session(clock, channel("q1", noise=0.0, device="adc"))
    for _ in range(1000):
        session.read(7)
    assert session.faults == []


def test_old_samples_are_stuck_whatever_the_noise(clock, channel):
    session = Session(clock, channel("q1", noise=0.0, device="adc"))
    for _ in range(150):
        session.read(7, ReadingFlag.STALE)
    assert session.kinds == [FaultKind.STUCK]
    session.read(7)
    assert session.kinds == [FaultKind.STUCK, FaultKind.CHANGING]


def test_a_channel_that_falls_silent_is_reported_once_and_when_it_is_back(session):
    session.read()
    for _ in range(300):
        session.pump()
    (silent,) = session.faults
    assert (silent.source, silent.kind) == ("q1", FaultKind.SILENT)
    session.read()
    assert session.kinds == [FaultKind.SILENT, FaultKind.ANSWERING]


@pytest.mark.parametrize("source", ["bus", "adc"])
def test_what_the_link_has_explained_is_not_said_again(session, source):
    session.read()
    session.report(source, FaultKind.BROKEN)
    session.link.lost += 30
    for _ in range(300):
        session.pump()
    session.link.lost += 30
    session.report(source, FaultKind.REOPENED)
    for _ in range(50):
        session.read()
    assert session.faults == []


def test_the_trouble_of_another_device_explains_nothing(session):
    session.read()
    session.report("other", FaultKind.SILENT)
    for _ in range(300):
        session.pump()
    assert session.kinds == [FaultKind.SILENT]


def test_losses_are_reported_when_they_begin_and_when_they_have_ended(session):
    for number in range(300):
        session.link.lost += number in (100, 130, 160)
        session.read()
    losing, complete = session.faults
    assert (losing.source, losing.kind) == ("q1", FaultKind.LOSING)
    assert complete.kind == FaultKind.COMPLETE
    assert "after 3 lost readings" in complete.text
    assert 1.0 <= (complete.time_ns - losing.time_ns) / 1e9 <= 2.0


def test_losses_that_were_taken_back_are_none(session):
    for number in range(300):
        session.link.lost += {100: 5, 101: -5}.get(number, 0)
        session.read()
    assert session.faults == []


def test_a_counter_that_goes_back_and_counts_on_is_a_restart(session):
    session.sequence = 1000
    for _ in range(10):
        session.read()
    session.sequence = 0
    for _ in range(10):
        session.read()
    began, ended = session.faults
    assert (began.source, began.kind, ended.kind) == (
        "adc",
        FaultKind.RESTARTED,
        FaultKind.STARTED,
    )
    assert "from 1010 to 1" in began.text


def test_a_counter_that_goes_back_once_is_a_message_out_of_order(session):
    for sequence in (10, 11, 13, 12, 14, 15, 16, 17):
        session.sequence = sequence - 1
        session.read()
    assert session.faults == []


def test_a_restart_that_the_link_has_reported_is_not_reported_again(session):
    session.sequence = 1000
    session.read()
    session.report("adc", FaultKind.RESTARTED)
    session.report("adc", FaultKind.STARTED)
    session.pump()
    session.sequence = 0
    for _ in range(10):
        session.read()
    assert session.faults == []


def test_nothing_is_watched_after_the_stop(session):
    session.read()
    session.watched.stop()
    for _ in range(300):
        session.pump()
    assert session.faults == []
