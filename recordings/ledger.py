"""The loss ledger of a recording being written: per channel, what came and where the rest went.

Owns the sums. What was received is told by whoever counts what is in the file; what was
lost on the way is told by the caller, as totals since the start or as whole entries.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from recordings.events import LedgerEntry


@dataclass(frozen=True, slots=True)
class Losses:
    """What the caller knows of one channel's losses; totals since the start."""

    expected: int
    dropped_by_device: int = 0
    dropped_by_host: int = 0
    lost_in_gaps: int = 0
    gaps: int = 0


class Ledger:
    """The accounts of all channels of a recording."""

    def __init__(self) -> None:
        self._losses: dict[str, Losses] = {}
        self._by_caller: dict[str, LedgerEntry] = {}
        self._lost_here: Counter[str] = Counter()

    def account(self, channel: str, losses: Losses) -> None:
        """Take what the caller knows of a channel's losses."""
        self._losses[channel] = losses

    def take(self, entry: LedgerEntry) -> None:
        """Take an entry of the caller's, who keeps this channel's account from now on."""
        self._by_caller[entry.source] = entry

    def lose(self, channel: str, count: int) -> None:
        """Readings of a channel that the caller handed over did not get into the file."""
        self._lost_here[channel] += count

    def is_kept_by_caller(self, channel: str) -> bool:
        """Whether the caller writes this channel's entries."""
        return channel in self._by_caller

    def entry(self, channel: str, received: int, time_ns: int) -> LedgerEntry:
        """The account of ``channel``, of which ``received`` readings are in the file.

        Where the caller keeps the account, what was handed over since its last entry is
        added to what it expected.
        """
        lost = self._lost_here[channel]
        given = self._by_caller.get(channel)
        if given is not None:
            return replace(
                given,
                time_ns=time_ns,
                expected=given.expected + received + lost - given.received,
                received=received,
                dropped_by_host=given.dropped_by_host + lost,
            )
        losses = self._losses.get(channel, Losses(received + lost))
        return LedgerEntry(
            source=channel,
            time_ns=time_ns,
            expected=losses.expected,
            received=received,
            dropped_by_device=losses.dropped_by_device,
            dropped_by_host=losses.dropped_by_host + lost,
            lost_in_gaps=losses.lost_in_gaps,
            gaps=losses.gaps,
        )
