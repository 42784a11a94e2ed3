"""What can happen in a capture session: the vocabulary that drivers, daq, writer and reader share.

Every event carries ``time_ns``, the host's time of arrival in nanoseconds since the Unix
epoch, on a monotonic clock anchored once to UTC. Raw counts stay raw.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag


class ReadingFlag(IntFlag):
    """What a device said about one reading."""

    NONE = 0
    OVERRANGE = 1
    STALE = 2
    DEVICE_ERROR = 4


@dataclass(frozen=True, slots=True)
class Reading:
    """One sample of one channel.

    Attributes:
        channel: channel name of the rig.
        time_ns: host arrival.
        raw: count as the device gave it.
        device_time_ns: time on the device's own clock, or None where it has none.
        sequence: device's sample counter (modulo 2**32), or None where it has none.
        flags: what the device said about this sample.
    """

    channel: str
    time_ns: int
    raw: int
    device_time_ns: int | None = None
    sequence: int | None = None
    flags: ReadingFlag = ReadingFlag.NONE


class Mode(IntEnum):
    """What a joint drive does."""

    UNKNOWN = 0
    OFF = 1
    FREE = 2
    POSITION = 3
    TORQUE = 4
    FAULT = 5


@dataclass(frozen=True, slots=True)
class ModeCommand:
    """A mode or target sent to a joint drive, and why.

    ``target_raw`` is in the counts of the channel that senses the joint (position mode),
    or in per mille of rated torque (torque mode).
    """

    joint: str
    time_ns: int
    mode: Mode
    target_raw: int | None
    cause: str


@dataclass(frozen=True, slots=True)
class ModeReport:
    """What a joint drive says it is doing. ``status`` is the device's own status word."""

    joint: str
    time_ns: int
    mode: Mode
    status: int
    error_code: int = 0


@dataclass(frozen=True, slots=True)
class Dwell:
    """The mechanism stood still from ``start_ns`` to ``end_ns``.

    It was visit number ``visit`` (from 0) of pose number ``pose``, with the endpoint held in
    ``fixture`` where the rig has fixtures.
    """

    time_ns: int
    start_ns: int
    end_ns: int
    pose: int
    visit: int
    fixture: str | None = None


@dataclass(frozen=True, slots=True)
class Mark:
    """A remark by the operator or the session."""

    time_ns: int
    text: str


@dataclass(frozen=True, slots=True)
class Fault:
    """Something went wrong at ``source``, a port, device or channel.

    ``kind`` is one word, ``text`` a sentence.
    """

    time_ns: int
    source: str
    kind: str
    text: str


class SessionState(IntEnum):
    """What a session may do; which commands each state allows is written in `daq.states`."""

    IDLE = 1
    ARMED = 2
    MOVING = 3
    RECORDING = 4
    SAFE = 5


@dataclass(frozen=True, slots=True)
class StateChange:
    """The session went from one state to another, and why."""

    time_ns: int
    before: SessionState
    after: SessionState
    cause: str


@dataclass(frozen=True, slots=True)
class ClockSample:
    """What was known at ``time_ns`` of the clock of ``source``, a device.

    Attributes:
        source: device of the rig.
        time_ns: when it was estimated.
        device_time_ns: a moment on the device's clock.
        offset_ns: host time minus device time then, of a reading that came without waiting:
            it contains the shortest delay of transport (see `RoundTrip`).
        uncertainty_ns: its standard uncertainty.
        drift_ppb: by how much ``offset_ns`` grows [ns per second of the device], or None.
        drift_uncertainty_ppb: its standard uncertainty, or None.
    """

    source: str
    time_ns: int
    device_time_ns: int
    offset_ns: int
    uncertainty_ns: int
    drift_ppb: int | None = None
    drift_uncertainty_ppb: int | None = None


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """Times from asking ``source`` to its answers, in the second or so before ``time_ns``.

    Each reading was taken between the two, so that all of them were at most ``longest_ns`` old
    when they arrived, and at least one at most ``shortest_ns``.
    """

    source: str
    time_ns: int
    shortest_ns: int
    longest_ns: int


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """Readings of one source so far: what should have come, what came, and where the rest went.

    expected = received + dropped_by_device + dropped_by_host + lost_in_gaps for a whole ledger;
    ``received`` counts what was handed to the file.
    """

    source: str
    time_ns: int
    expected: int
    received: int
    dropped_by_device: int
    dropped_by_host: int
    lost_in_gaps: int
    gaps: int

    @property
    def unaccounted(self) -> int:
        """Readings that neither arrived nor are explained; 0 in a whole ledger."""
        explained = (
            self.received + self.dropped_by_device + self.dropped_by_host + self.lost_in_gaps
        )
        return self.expected - explained


Event = (
    Reading
    | ModeCommand
    | ModeReport
    | Dwell
    | Mark
    | Fault
    | StateChange
    | ClockSample
    | RoundTrip
    | LedgerEntry
)
