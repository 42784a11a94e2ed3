"""Between the buses and the file: a bounded queue that never makes a bus wait.

Back-pressure policy: when the queue is full, the newest readings are dropped and counted
per channel. Everything else (mode commands and reports, dwells, faults, checkpoints) is
rare and says what happened to the readings, so it is always taken.

Who takes from it is woken by checkpoints, and once there is much to take: a thread that is woken
for every frame of a full bus takes the processor from those that read the buses.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers import Losses
from recordings.events import Event, Reading


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The losses of one link at a point of the stream: all that arrived before is ahead of it.

    Attributes:
        losses: per channel, what the driver knows to be missing.
        dropped_by_host: per channel, readings that this queue refused.
    """

    losses: Mapping[str, Losses]
    dropped_by_host: Mapping[str, int]


Item = Event | Checkpoint

MUCH = 2000
"""Items that are worth waking somebody for; half of a full queue, where that is fewer."""


class EventQueue:
    """A bounded first-in, first-out queue from the threads of the links to the recorder."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._much = min(MUCH, (capacity + 1) // 2)
        self._items: deque[Item] = deque()
        self._closed = False
        self._due = False
        self._changed = threading.Condition()

    def offer(self, items: Sequence[Item]) -> Counter[str]:
        """Append ``items`` without waiting; return how many readings of each channel were dropped."""
        dropped: Counter[str] = Counter()
        with self._changed:
            if len(self._items) + len(items) <= self._capacity:
                self._items.extend(items)
            else:
                for item in items:
                    if isinstance(item, Reading) and len(self._items) >= self._capacity:
                        dropped[item.channel] += 1
                    else:
                        self._items.append(item)
            if len(self._items) >= self._much or (items and isinstance(items[-1], Checkpoint)):
                self._due = True
                self._changed.notify()
        return dropped

    def take(self, timeout_s: float) -> list[Item] | None:
        """All that waits, in order, once it is due or after ``timeout_s``; None once closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._due, timeout_s)
            self._due = False
            if self._closed and not self._items:
                return None
            items = list(self._items)
            self._items.clear()
            return items

    @property
    def waiting(self) -> int:
        """Items that wait to be taken."""
        return len(self._items)

    def close(self) -> None:
        """Nothing more will be offered."""
        with self._changed:
            self._closed = True
            self._changed.notify()
