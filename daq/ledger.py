"""The loss ledger: per channel, what should have come, what came, and where the rest went.

Readings are counted when they are handed to the file. What a driver and the queue know to
be missing arrives as checkpoints in the same stream, behind the readings it speaks of, so
that every entry is whole: expected = received + dropped_by_device + dropped_by_host +
lost_in_gaps, at every moment and not only at the end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

from daq.event_queue import Checkpoint
from recordings.events import LedgerEntry


class Ledger:
    """Counts of all channels of one session."""

    def __init__(self) -> None:
        self._received: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._entries: dict[str, LedgerEntry] = {}

    def received(self, channel: str) -> None:
        """One reading of ``channel`` was handed to the file."""
        self._received[channel] += 1

    def lost(self, channel: str, count: int) -> None:
        """Readings that were handed to the file are not in it: its disk failed."""
        self._received[channel] -= count
        self._refused[channel] += count
        entry = self._entries.get(channel)
        if entry is not None:  # the last one, unless a checkpoint is still to come
            self._entries[channel] = replace(
                entry,
                received=entry.received - count,
                dropped_by_host=entry.dropped_by_host + count,
            )

    def refused(self, channel: str) -> None:
        """One reading of ``channel`` came when nothing could be written any more."""
        self._refused[channel] += 1

    def reach(self, checkpoint: Checkpoint, now_ns: int) -> None:
        """All readings before ``checkpoint`` have been handed to the file: strike the balance."""
        for channel, losses in checkpoint.losses.items():
            self._entries[channel] = LedgerEntry(
                source=channel,
                time_ns=now_ns,
                expected=losses.expected,
                received=self._received[channel],
                dropped_by_device=losses.dropped_by_device,
                dropped_by_host=checkpoint.dropped_by_host.get(channel, 0) + self._refused[channel],
                lost_in_gaps=losses.lost_in_gaps,
                gaps=losses.gaps,
            )

    @property
    def entries(self) -> Mapping[str, LedgerEntry]:
        """Latest balance of each channel that a checkpoint has spoken of."""
        return dict(self._entries)
