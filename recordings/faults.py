"""The kinds of faults, which of them begin and end, and the episodes that their events make.

A `recordings.events.Fault` is a moment. What lasts (a port that is away, a channel that is
stuck) is recorded as two of them from the same source: the kind that begins it, and the kind
that ends it. `ENDED_BY` says which belong together; kinds that are not in it have no duration.
Other programs may write other kinds: they are moments here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from recordings.events import Fault


class FaultKind(StrEnum):
    """``Fault.kind`` of everything that a link reports; its source is a port, device or channel."""

    BROKEN = "broken"
    """The port went away."""
    BUS_OFF = "bus-off"
    """The CAN controller has left the bus after too many errors; the port is opened again."""
    REOPENED = "reopened"
    """The port is back."""
    SILENT = "silent"
    """A device, or a channel, stopped to answer."""
    REFUSED = "refused"
    """A device answers that it will not give its readings."""
    ANSWERING = "answering"
    """It answers again."""
    RESTARTED = "restarted"
    """A device has restarted by itself; a drive is then off."""
    NOT_STARTED = "not-started"
    """A device could not be set up again after an interruption; it is tried again."""
    STARTED = "started"
    """A device is set up again."""
    STUCK = "stuck"
    """A channel repeats one value, in a way that its noise or its sample counter rules out."""
    CHANGING = "changing"
    """The channel measures again."""
    LOSING = "losing"
    """Readings of a channel are missing although its port works."""
    COMPLETE = "complete"
    """The channel is complete again."""
    DUPLICATED = "duplicated"
    """Two devices answer under one address: which of them a reading is from cannot be known."""
    SINGLE = "single"
    """Only one device answers again."""
    BABBLE = "babble"
    """The bus or line is filled with what nobody asked for."""
    QUIET = "quiet"
    """The babble has ended."""
    FOREIGN = "foreign"
    """Something that the rig does not name is heard: another node, another unit's reply."""
    FOREIGN_OVER = "foreign-over"
    """It has not been heard for a while."""
    MALFORMED = "malformed"
    """Frames or bytes came that make no sense: a bad checksum, a bad length, bad hex."""
    MALFORMED_OVER = "malformed-over"
    """Nothing malformed has come for a while."""
    LATE = "late"
    """A reply came after its request had been given up; it was discarded."""
    LATE_OVER = "late-over"
    """No late reply has come for a while."""
    BUS_ERROR = "bus-error"
    """The CAN controller reports an error frame."""
    BUS_ERROR_OVER = "bus-error-over"
    """No error frame has come for a while."""
    EMERGENCY = "emergency"
    """A device reports an error of its own (CANopen EMCY)."""
    EMERGENCY_OVER = "emergency-over"
    """The device reports that it has no error any more."""


ENDED_BY: Mapping[str, FaultKind] = MappingProxyType(
    {
        FaultKind.BROKEN: FaultKind.REOPENED,
        FaultKind.BUS_OFF: FaultKind.REOPENED,
        FaultKind.SILENT: FaultKind.ANSWERING,
        FaultKind.REFUSED: FaultKind.ANSWERING,
        FaultKind.RESTARTED: FaultKind.STARTED,
        FaultKind.NOT_STARTED: FaultKind.STARTED,
        FaultKind.STUCK: FaultKind.CHANGING,
        FaultKind.LOSING: FaultKind.COMPLETE,
        FaultKind.DUPLICATED: FaultKind.SINGLE,
        FaultKind.BABBLE: FaultKind.QUIET,
        FaultKind.FOREIGN: FaultKind.FOREIGN_OVER,
        FaultKind.MALFORMED: FaultKind.MALFORMED_OVER,
        FaultKind.LATE: FaultKind.LATE_OVER,
        FaultKind.BUS_ERROR: FaultKind.BUS_ERROR_OVER,
        FaultKind.EMERGENCY: FaultKind.EMERGENCY_OVER,
    }
)
"""The kind that ends each kind that lasts."""

ENDS: frozenset[str] = frozenset(ENDED_BY.values())
"""Kinds that say that something is over."""


@dataclass(frozen=True, slots=True)
class Episode:
    """A fault from its beginning to its end.

    Attributes:
        source: port, device or channel.
        kind: kind that began it.
        begin_ns: when it was detected.
        end_ns: when it was over; its beginning for a kind without duration; None while it lasts.
        text: what its beginning said.
    """

    source: str
    kind: str
    begin_ns: int
    end_ns: int | None
    text: str


def episodes(faults: Iterable[Fault]) -> tuple[Episode, ...]:
    """The faults of a session as episodes, in the order of their beginnings.

    What repeats while it lasts belongs to the episode that is open already.
    """
    found: list[Episode] = []
    open_at: dict[tuple[str, str], int] = {}
    for fault in faults:
        if fault.kind in ENDS:
            for kind, end in ENDED_BY.items():
                if end == fault.kind and (fault.source, kind) in open_at:
                    at = open_at.pop((fault.source, kind))
                    begun = found[at]
                    found[at] = Episode(
                        begun.source, begun.kind, begun.begin_ns, fault.time_ns, begun.text
                    )
            continue
        if (fault.source, fault.kind) in open_at:
            continue
        lasts = fault.kind in ENDED_BY
        if lasts:
            open_at[fault.source, fault.kind] = len(found)
        end_ns = None if lasts else fault.time_ns
        found.append(Episode(fault.source, fault.kind, fault.time_ns, end_ns, fault.text))
    return tuple(found)
