"""Queue, ledger and recorder: nothing is lost that is not counted, and a bus never waits."""

from __future__ import annotations

import threading

import pytest

from daq.clock import ManualClock
from daq.event_queue import Checkpoint, EventQueue
from daq.recorder import Recorder
from drivers import Losses
from recordings.errors import RecordingError
from recordings.events import Dwell, Fault, LedgerEntry, Reading


class Sink:
    """A file in memory; its disk can be held up, or fail."""

    def __init__(self) -> None:
        self.events: list[object] = []
        self.free = threading.Event()
        self.free.set()
        self.fails = False
        self.closed = False

    def write(self, event: object) -> None:
        assert self.free.wait(10.0)
        if self.fails:
            raise RecordingError("no space left on device")
        self.events.append(event)

    def flush(self) -> None:
        self.events.append("flush")

    def close(self) -> None:
        self.closed = True


def readings(count, channel="q1"):
    return [Reading(channel, i, i) for i in range(count)]


def test_a_full_queue_drops_the_newest_readings_and_keeps_the_rest():
    queue = EventQueue(capacity=5)
    dwell = Dwell(9, 1, 2, 0, 0)
    assert queue.offer(readings(8)) == {"q1": 3}
    assert queue.offer([dwell]) == {}
    assert queue.take(0.0) == [*readings(5), dwell]


def test_overflow_is_accounted_for():
    sink = Sink()
    sink.free.clear()
    queue = EventQueue(capacity=100)
    recorder = Recorder(sink, queue, ManualClock())
    recorder.start()
    dropped = 0
    sent = 0
    while dropped < 50:
        sent += 10
        dropped += queue.offer(readings(10))["q1"]
    queue.offer([Checkpoint({"q1": Losses(sent + 7, 4, 3, 1)}, {"q1": dropped})])
    sink.free.set()
    queue.close()
    recorder.join()
    entry = recorder.ledger["q1"]
    written = [event for event in sink.events if isinstance(event, Reading)]
    assert entry.unaccounted == 0
    assert entry.dropped_by_host == dropped
    assert entry.received == len(written) == sent - dropped
    assert [event.kind for event in sink.events if isinstance(event, Fault)] == ["overflow"]
    assert isinstance(sink.events[-1], LedgerEntry)
    assert sink.closed


def test_the_ledger_is_whole_at_every_checkpoint():
    sink = Sink()
    queue = EventQueue(capacity=100)
    recorder = Recorder(sink, queue, ManualClock())
    for sent in (10, 20, 30):
        queue.offer([*readings(10), Checkpoint({"q1": Losses(sent, 0, 0, 0)}, {})])
        queue.offer(readings(0))
    queue.close()
    recorder.start()
    recorder.join()
    assert recorder.ledger["q1"].received == 30
    assert recorder.ledger["q1"].unaccounted == 0


def test_it_flushes_on_a_timer():
    sink = Sink()
    queue = EventQueue(capacity=100)
    clock = ManualClock()
    recorder = Recorder(sink, queue, clock)
    recorder.start()
    flushed = 0
    for _ in range(4):
        clock.advance(0.5)
        queue.offer(readings(1))
        for _ in range(1000):
            if sink.events.count("flush") > flushed:
                break
            threading.Event().wait(0.005)
        assert sink.events.count("flush") > flushed
        flushed = sink.events.count("flush")
    queue.close()
    recorder.join()


def test_a_disk_that_fails_is_kept_for_the_session_and_blocks_nobody():
    sink = Sink()
    sink.fails = True
    queue = EventQueue(capacity=3)
    recorder = Recorder(sink, queue, ManualClock())
    recorder.start()
    queue.offer(readings(1))
    recorder.join()
    assert isinstance(recorder.failure, RecordingError)
    assert queue.offer(readings(5)) == {"q1": 2}
    assert sink.closed


def test_a_bug_in_the_writer_is_not_hidden():
    sink = Sink()
    sink.write = lambda event: 1 / 0
    queue = EventQueue(capacity=3)
    recorder = Recorder(sink, queue, ManualClock())
    recorder.start()
    queue.offer(readings(1))
    recorder.join()
    with pytest.raises(ZeroDivisionError):
        raise recorder.failure
