"""What the messages of one topic say of their own completeness and time, counted as they pass.

Owns the sums over a topic: sequence numbers that are missing, times that go back, silences,
and for readings what the device's counter and the counts themselves show. Holds no messages.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recordings.columns import Columns
from recordings.events import ReadingFlag

_LONG_NS = 250_000_000
_MOST_SILENCES = 10_000
_HALF = 2**31  # a counter that goes on by more has gone back


@dataclass(frozen=True, slots=True)
class Hole:
    """Messages ``first`` to ``first + count - 1`` of a topic, which are not there.

    They lay between the messages of ``after_ns`` and ``before_ns``; None at an end of the file.
    """

    first: int
    count: int
    after_ns: int | None
    before_ns: int | None


@dataclass(slots=True)
class Tally:
    """Sums over the messages of one topic, in the order of the file.

    Attributes:
        count: messages.
        first_ns, last_ns: earliest and latest time.
        next: sequence number of the next message, as the file counts them; None where the first
            one is still to come and may have any number.
        holes: messages that are missing by those numbers.
        counts_up: whether the numbers are a count at all; not every program's are.
        backwards: messages that are earlier than the one before.
        furthest_back_ns: by how much at most.
        silences: (time, duration) of long intervals between two messages [ns].
    """

    count: int = 0
    first_ns: int = 2**63 - 1
    last_ns: int = -1
    next: int | None = None
    holes: list[Hole] = field(default_factory=list)
    counts_up: bool = True
    backwards: int = 0
    furthest_back_ns: int = 0
    silences: list[tuple[int, int]] = field(default_factory=list)
    _latest_ns: int | None = None

    def add(self, time_ns: NDArray[np.int64], sequence: NDArray[np.uint32]) -> None:
        """Take the next messages.

        Args:
            time_ns: (n,) their times.
            sequence: (n,) their MCAP sequence numbers.
        """
        if len(time_ns) == 0:
            return
        self._number(time_ns, sequence)
        before = time_ns[0] if self._latest_ns is None else self._latest_ns
        steps = np.diff(time_ns, prepend=before)
        back = steps < 0
        if back.any():
            self.backwards += int(back.sum())
            self.furthest_back_ns = max(self.furthest_back_ns, -int(steps.min()))
        if len(self.silences) < _MOST_SILENCES:
            for row in np.flatnonzero(steps > _LONG_NS).tolist():
                self.silences.append((int(time_ns[row] - steps[row]), int(steps[row])))
        self.count += len(time_ns)
        self.first_ns = min(self.first_ns, int(time_ns.min()))
        self.last_ns = max(self.last_ns, int(time_ns.max()))
        self._latest_ns = int(time_ns[-1])

    def _number(self, time_ns: NDArray[np.int64], sequence: NDArray[np.uint32]) -> None:
        if not self.counts_up:
            return
        if self.next is None:
            self.next = int(sequence[0])
        numbered = np.concatenate([[self.next % 2**32 - 1], sequence.astype(np.int64)])
        steps: NDArray[np.int64] = np.diff(numbered) % 2**32
        if np.any((steps == 0) | (steps >= _HALF)):
            self.counts_up = False
            self.holes.clear()
            return
        numbers = self.next - 1 + np.cumsum(steps)
        for row in np.flatnonzero(steps > 1).tolist():
            missing = int(steps[row]) - 1
            after = int(time_ns[row - 1]) if row else self._latest_ns
            hole = Hole(int(numbers[row]) - missing, missing, after, int(time_ns[row]))
            self.holes.append(hole)
        self.next = int(numbers[-1]) + 1

    def end(self, total: int) -> None:
        """Say how many messages there were in all, where something else tells."""
        if self.counts_up and self.next is not None and total > self.next:
            self.holes.append(Hole(self.next, total - self.next, self._latest_ns, None))
            self.next = total

    @property
    def missing(self) -> int | None:
        """Messages that are not there, or None where the file does not count them."""
        return sum(hole.count for hole in self.holes) if self.counts_up else None

    @property
    def typical_ns(self) -> float:
        """Mean interval between messages, long silences left out where they are few."""
        span, intervals = self.last_ns - self.first_ns, self.count - 1
        if intervals < 1:
            return 0.0
        quick = intervals - len(self.silences)
        if quick * 2 < intervals:
            return span / intervals
        return max(0.0, (span - sum(length for _, length in self.silences)) / quick)


@dataclass(slots=True)
class ReadingTally:
    """Sums over the readings of one channel, in the order of the file.

    Attributes:
        low, high: smallest and largest count.
        same_since_ns, same_until_ns, same: the longest row of equal counts: when, and how many.
        flags: readings by flag.
        skipped, restarts: readings left out by the device's own counter, and how often it went
            back; None where there is no counter.
        unreadable: messages that are no readings.
    """

    low: int = 2**63 - 1
    high: int = -(2**63)
    same: int = 0
    same_since_ns: int = 0
    same_until_ns: int = 0
    flags: dict[ReadingFlag, int] = field(default_factory=dict)
    skipped: int | None = None
    restarts: int = 0
    unreadable: int = 0
    _row: tuple[int, int, int] | None = None  # value, readings and start of the row at the end
    _counter: int | None = None

    def add(self, found: Columns) -> None:
        """Take the next readings."""
        if len(found.raw) == 0:
            return
        self.low = min(self.low, int(found.raw.min()))
        self.high = max(self.high, int(found.raw.max()))
        self._watch_rows(found.raw, found.time_ns)
        if found.flags.any():
            for flag in ReadingFlag:
                count = int(np.count_nonzero(found.flags & np.uint32(flag)))
                if count:
                    self.flags[flag] = self.flags.get(flag, 0) + count
        if found.sequence is None:
            self._counter = None
            return
        counter = found.sequence.astype(np.int64)
        before = counter[0] - 1 if self._counter is None else self._counter
        steps = np.diff(counter, prepend=before) % 2**32
        back = (steps == 0) | (steps >= _HALF)
        self.restarts += int(back.sum())
        self.skipped = (self.skipped or 0) + int((steps[~back] - 1).sum())
        self._counter = int(counter[-1])

    def _watch_rows(self, raw: NDArray[np.int64], time_ns: NDArray[np.int64]) -> None:
        starts = np.flatnonzero(np.diff(raw, prepend=~raw[0]))
        stops = np.append(starts[1:], len(raw))
        lengths = stops - starts
        since = time_ns[starts]
        if self._row is not None and self._row[0] == int(raw[0]):
            lengths[0] += self._row[1]
            since[0] = self._row[2]
        best = int(np.argmax(lengths))
        if lengths[best] > self.same:
            self.same = int(lengths[best])
            self.same_since_ns = int(since[best])
            self.same_until_ns = int(time_ns[stops[best] - 1])
        self._row = (int(raw[-1]), int(lengths[-1]), int(since[-1]))
