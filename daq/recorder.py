"""The recorder: the one thread that writes the file.

It empties the queue, keeps the ledger, and flushes on a timer, so that a killed process
loses at most `FLUSH_S` and what was on its way. Readings wait for the next flush, because those
of a channel are written together for a fraction of what each alone would cost; their order
within a channel stays. A disk that is nearly full is told to the session, which ends in order
while there is room for its end. A disk that fails stops the recording, not the buses: the session
ends too, and what still comes is counted as dropped.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from numpy.typing import ArrayLike

from daq.clock import SECOND, Clock
from daq.event_queue import Checkpoint, EventQueue, Item
from daq.ledger import Ledger
from daq.waiting import Waiting
from recordings.errors import DiskFailed, RecordingError
from recordings.events import Event, Fault, LedgerEntry, Reading

FLUSH_S = 0.25
"""Time between flushes [s]: half of the 0.5 s that may be at risk, the rest is for the disk."""

TAKE_S = 0.05
"""Longest time before what has come is looked at [s]; a flush can be later by as much."""

MOST_WAITING = 10_000
"""Readings that wait for a flush, at most; the next one makes room."""


class EventSink(Protocol):
    """What a recorder needs of a writer."""

    @property
    def nearly_full(self) -> str: ...
    def write(self, event: Event) -> None: ...
    def write_readings(
        self,
        channel: str,
        time_ns: ArrayLike,
        raw: ArrayLike,
        device_time_ns: ArrayLike | None = None,
        sequence: ArrayLike | None = None,
        flags: ArrayLike | None = None,
    ) -> None: ...
    def flush(self) -> None: ...
    def close(self) -> None: ...


class Recorder:
    """Writes what comes through a queue until the queue is closed, then closes the file."""

    def __init__(self, writer: EventSink, queue: EventQueue, clock: Clock) -> None:
        self._writer = writer
        self._queue = queue
        self._ledger = Ledger()
        self._clock = clock
        self._entries = self._ledger.entries
        self._waiting: dict[str, Waiting] = {}
        self._count = 0
        self._failure: Exception | None = None
        self._nearly_full: RecordingError | None = None
        self._thread = threading.Thread(target=self._run, name="loopcal-recorder")

    @property
    def failure(self) -> Exception | None:
        """Why the file can no longer be written, or None while it can."""
        return self._failure

    @property
    def must_end(self) -> Exception | None:
        """Why the session must end now: a failure, or a disk with little more room than that takes."""
        return self._failure or self._nearly_full

    @property
    def ledger(self) -> Mapping[str, LedgerEntry]:
        """Latest whole balance of each channel; may be read from any thread."""
        return self._entries

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def join(self) -> None:
        """Wait until the closed queue is written out and the file is closed."""
        self._thread.join()

    def _run(self) -> None:
        try:
            self._record()
        except Exception as error:  # noqa: BLE001 - the end of a thread: the session must see it
            self._failed(error)
            self._save_waiting()
        try:
            self._writer.close()
        except (RecordingError, OSError) as error:
            self._failed(error)
        while (items := self._queue.take(TAKE_S)) is not None:
            self._refuse(items)

    def _failed(self, error: Exception) -> None:
        self._failure = self._failure or error
        if isinstance(error, DiskFailed):
            for channel, count in error.lost.items():
                self._ledger.lost(channel, count)
            self._entries = self._ledger.entries

    def _refuse(self, items: Iterable[Item]) -> None:
        """Count what comes when nothing can be written any more."""
        for item in items:
            if isinstance(item, Checkpoint):
                self._ledger.reach(item, self._clock.now_ns())
            elif isinstance(item, Reading):
                self._ledger.refused(item.channel)
        self._entries = self._ledger.entries

    def _record(self) -> None:
        flushed_ns = self._clock.now_ns()
        while (items := self._queue.take(TAKE_S)) is not None:
            waiting = iter(items)
            try:
                for item in waiting:
                    self._take(item)
            except Exception:
                self._refuse(waiting)
                raise
            now_ns = self._clock.now_ns()
            if now_ns - flushed_ns >= FLUSH_S * SECOND:
                self._write_waiting()
                self._write_ledger()
                self._writer.flush()
                flushed_ns = now_ns
                if self._nearly_full is None and (why := self._writer.nearly_full):
                    self._nearly_full = RecordingError(why)
        self._write_waiting()
        self._write_ledger()

    def _take(self, item: Item) -> None:
        if isinstance(item, Reading):
            self._ledger.received(item.channel)
            waiting = self._waiting.get(item.channel)
            if waiting is None:
                waiting = self._waiting[item.channel] = Waiting()
            waiting.add(item)
            self._count += 1
            if self._count >= MOST_WAITING:
                self._write_waiting()
        elif isinstance(item, Checkpoint):
            self._balance(item)
        else:
            self._writer.write(item)

    def _write_waiting(self) -> None:
        """Write the readings that wait, channel by channel; all are counted, whatever happens."""
        waiting, self._waiting, self._count = self._waiting, {}, 0
        left = {channel: len(readings) for channel, readings in waiting.items()}
        try:
            for channel, readings in waiting.items():
                for count, columns in readings.columns():
                    left[channel] -= count
                    self._write_readings(channel, count, columns)
        except Exception:
            for channel, count in left.items():
                self._ledger.lost(channel, count)
            raise

    def _save_waiting(self) -> None:
        """What waits when something could not be written is written, or counted if the disk has failed."""
        if not isinstance(self._failure, DiskFailed):
            try:
                self._write_waiting()
            except Exception as error:  # noqa: BLE001 - the first failure is told, this one is counted
                self._failed(error)
        for channel, readings in self._waiting.items():
            self._ledger.lost(channel, len(readings))
        self._waiting.clear()
        self._entries = self._ledger.entries

    def _write_readings(self, channel: str, count: int, columns: dict[str, Any]) -> None:
        try:
            self._writer.write_readings(channel, **columns)
        except Exception as error:
            # A failed disk says itself what it took with it, of all that it was given.
            if not isinstance(error, DiskFailed):
                self._ledger.lost(channel, count)
            raise

    def _balance(self, checkpoint: Checkpoint) -> None:
        now_ns = self._clock.now_ns()
        before = self._entries
        self._ledger.reach(checkpoint, now_ns)
        self._entries = self._ledger.entries
        for channel in checkpoint.losses:
            already = before[channel].dropped_by_host if channel in before else 0
            dropped = self._entries[channel].dropped_by_host - already
            if dropped > 0:
                text = f"{dropped} readings of {channel} were dropped, because the file could not keep up"
                self._writer.write(Fault(now_ns, channel, "overflow", text))

    def _write_ledger(self) -> None:
        for entry in self._entries.values():
            self._writer.write(entry)
