"""Queue, ledger and recorder: nothing is lost that is not counted, and a bus never waits."""

from __future__ import annotations

import threading

import pytest

from daq.clock import ManualClock
from daq.event_queue import Checkpoint, EventQueue
from daq.recorder import Recorder
from drivers import Losses
from recordings.errors import DiskFailed, RecordingError
from recordings.events import Dwell, Fault, LedgerEntry, Reading


class Sink:
    """A file in memory; its disk can be held up, or fail."""

    def __init__(self) -> None:
        self.events: list[object] = []
        self.free = threading.Event()
        self.free.set()
        self.fails: Exception | None = None
        self.closed = False
        self.nearly_full = ""

    def write(self, event: object) -> None:
        assert self.free.wait(60.0)
        if self.fails:
            raise self.fails
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
        for _ in range(12_000):
            if sink.events.count("flush") > flushed:
                break
            threading.Event().wait(0.005)
        assert sink.events.count("flush") > flushed
        flushed = sink.events.count("flush")
    queue.close()
    recorder.join()


@pytest.mark.parametrize("waiting", [7, 0])
def test_what_comes_after_the_disk_failed_is_accounted_for_and_blocks_nobody(waiting):
    """The disk takes 7 readings that waited with it; or the event that it refuses is no reading."""
    sink = Sink()
    queue = EventQueue(capacity=100)
    recorder = Recorder(sink, queue, ManualClock())
    queue.offer(readings(20))
    queue.offer([Checkpoint({"q1": Losses(20, 0, 0, 0)}, {})])
    recorder.start()
    while "q1" not in recorder.ledger:
        threading.Event().wait(0.001)
    sink.fails = DiskFailed("the disk is full", {"q1": waiting} if waiting else {})
    queue.offer([*(readings(1) if waiting else [Dwell(9, 1, 2, 0, 0)]), *readings(9)])
    for sent in range(30, 330, 10):
        assert queue.offer(readings(10)) == {}, "nobody takes from the queue"
        while queue.waiting:
            threading.Event().wait(0.001)
        queue.offer([Checkpoint({"q1": Losses(sent + 10, 0, 0, 0)}, {})])
    queue.offer([Checkpoint({"q1": Losses(329 + bool(waiting), 0, 0, 0)}, {})])
    queue.close()
    recorder.join()
    assert isinstance(recorder.failure, DiskFailed)
    entry = recorder.ledger["q1"]
    assert entry.unaccounted == 0
    assert entry.received == 20 + bool(waiting) - waiting
    assert sink.closed


def test_what_a_disk_takes_with_it_at_the_very_end_is_accounted_for():
    sink = Sink()

    def close():
        raise DiskFailed("the disk is full", {"q1": 4})

    sink.close = close
    queue = EventQueue(capacity=100)
    recorder = Recorder(sink, queue, ManualClock())
    queue.offer([*readings(10), Checkpoint({"q1": Losses(10, 0, 0, 0)}, {})])
    queue.close()
    recorder.start()
    recorder.join()
    entry = recorder.ledger["q1"]
    assert (entry.received, entry.dropped_by_host, entry.unaccounted) == (6, 4, 0)


def test_an_event_that_the_writer_refuses_is_accounted_for():
    sink = Sink()
    sink.fails = RecordingError("a number does not fit")
    queue = EventQueue(capacity=3)
    recorder = Recorder(sink, queue, ManualClock())
    queue.offer([*readings(3), Checkpoint({"q1": Losses(3, 0, 0, 0)}, {})])
    queue.close()
    recorder.start()
    recorder.join()
    assert isinstance(recorder.failure, RecordingError)
    assert recorder.ledger["q1"].dropped_by_host == 3
    assert recorder.ledger["q1"].unaccounted == 0


def test_a_nearly_full_disk_ends_the_session_and_is_no_failure():
    sink = Sink()
    sink.nearly_full = "3 MB left"
    queue = EventQueue(capacity=100)
    clock = ManualClock()
    recorder = Recorder(sink, queue, clock)
    recorder.start()
    while recorder.must_end is None:
        clock.advance(0.5)
        queue.offer(readings(1))
        threading.Event().wait(0.001)
    assert "3 MB left" in str(recorder.must_end)
    queue.offer([Dwell(9, 1, 2, 0, 0)])
    queue.close()
    recorder.join()
    assert Dwell(9, 1, 2, 0, 0) in sink.events
    assert recorder.failure is None


def test_a_bug_in_the_writer_is_not_hidden():
    sink = Sink()
    sink.write = lambda event: 1 / 0
    queue = EventQueue(capacity=3)
    recorder = Recorder(sink, queue, ManualClock())
    recorder.start()
    queue.offer(readings(1))
    queue.close()
    recorder.join()
    with pytest.raises(ZeroDivisionError):
        raise recorder.failure
