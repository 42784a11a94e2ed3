"""Queue, ledger and recorder: nothing is lost that is not counted, and a bus never waits."""

from __future__ import annotations

import threading

import pytest

from daq.clock import ManualClock
from daq.event_queue import Checkpoint, EventQueue
from daq.recorder import MOST_WAITING, Recorder
from drivers import Losses
from recordings.errors import DiskFailed, RecordingError
from recordings.events import Dwell, Fault, LedgerEntry, Reading, ReadingFlag


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

    def write_readings(self, channel, time_ns, raw, device_time_ns, sequence, flags) -> None:
        assert self.free.wait(60.0)
        if self.fails:
            raise self.fails
        absent = [None] * len(raw)
        columns = (time_ns, raw, device_time_ns or absent, sequence or absent, flags or absent)
        self.events += [
            Reading(channel, *rest, flag or ReadingFlag.NONE)
            for *rest, flag in zip(*columns, strict=True)
        ]

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


@pytest.mark.parametrize("chunk", [7, 0])
def test_what_comes_after_the_disk_failed_is_accounted_for_and_blocks_nobody(chunk):
    """The disk takes what it is given and 7 readings of the open chunk; or it refuses a dwell."""
    sink = Sink()
    queue = EventQueue(capacity=100)
    clock = ManualClock()
    recorder = Recorder(sink, queue, clock)
    recorder.start()
    clock.advance(1.0)
    queue.offer([*readings(20), Checkpoint({"q1": Losses(20, 0, 0, 0)}, {})])
    while "flush" not in sink.events:
        threading.Event().wait(0.001)
    given = 3 if chunk else 0
    sink.fails = DiskFailed("the disk is full", {"q1": given + chunk} if chunk else {})
    clock.advance(1.0)
    queue.offer([*readings(3), *([] if chunk else [Dwell(9, 1, 2, 0, 0)])])
    while recorder.failure is None:
        threading.Event().wait(0.001)
    for sent in range(23, 323, 10):
        assert queue.offer(readings(10)) == {}, "nobody takes from the queue"
        while queue.waiting:
            threading.Event().wait(0.001)
        queue.offer([Checkpoint({"q1": Losses(sent + 10, 0, 0, 0)}, {})])
    queue.close()
    recorder.join()
    assert isinstance(recorder.failure, DiskFailed)
    entry = recorder.ledger["q1"]
    assert entry.unaccounted == 0
    assert (entry.expected, entry.received) == (323, 20 - chunk)
    assert sink.closed


def test_readings_of_a_channel_keep_their_order_whatever_they_lack():
    sink = Sink()
    queue = EventQueue(capacity=100)
    recorder = Recorder(sink, queue, ManualClock())
    told = [
        Reading("q1", 1, 10, 5, 1),
        Reading("q2", 2, 20),
        Reading("q1", 3, 11, 6, 2, ReadingFlag.STALE),
        Reading("q1", 4, 12, None, 3),
        Reading("q2", 5, 21, None, None, ReadingFlag.DEVICE_ERROR),
        Reading("q1", 6, 13, 7, None),
        Reading("q1", 7, 14, 8, 4),
    ]
    queue.offer(told)
    queue.close()
    recorder.start()
    recorder.join()
    assert recorder.failure is None
    for channel in ("q1", "q2"):
        own = [reading for reading in told if reading.channel == channel]
        assert [e for e in sink.events if getattr(e, "channel", "") == channel] == own


def test_more_readings_than_may_wait_are_written_before_the_next_flush():
    sink = Sink()
    queue = EventQueue(capacity=10 * MOST_WAITING)
    recorder = Recorder(sink, queue, ManualClock())
    queue.offer(readings(2 * MOST_WAITING + 1))
    recorder.start()
    while len(sink.events) < 2 * MOST_WAITING:
        threading.Event().wait(0.001)
    assert "flush" not in sink.events
    queue.close()
    recorder.join()
    assert [e.raw for e in sink.events] == list(range(2 * MOST_WAITING + 1))


def test_of_several_channels_what_one_cannot_hold_costs_the_others_nothing_uncounted():
    """The writer takes q1, refuses q2 and is not asked for q3."""
    sink = Sink()
    took = sink.write_readings

    def write_readings(channel, **columns):
        if channel == "q2":
            raise RecordingError("a number does not fit")
        took(channel, **columns)

    sink.write_readings = write_readings
    queue = EventQueue(capacity=100)
    recorder = Recorder(sink, queue, ManualClock())
    for channel, count in (("q1", 3), ("q2", 4), ("q3", 5)):
        queue.offer([*readings(count, channel), Checkpoint({channel: Losses(count, 0, 0, 0)}, {})])
    queue.close()
    recorder.start()
    recorder.join()
    entries = {name: (e.received, e.dropped_by_host) for name, e in recorder.ledger.items()}
    assert entries == {"q1": (3, 0), "q2": (0, 4), "q3": (0, 5)}


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
    sink.write_readings = lambda channel, **columns: 1 / 0
    queue = EventQueue(capacity=3)
    recorder = Recorder(sink, queue, ManualClock())
    recorder.start()
    queue.offer(readings(1))
    queue.close()
    recorder.join()
    with pytest.raises(ZeroDivisionError):
        raise recorder.failure
