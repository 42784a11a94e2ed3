"""What links report as faults, and how often they repeat themselves. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from drivers.schedule import SECOND
from recordings.events import Fault


class FaultKind(StrEnum):
    """``Fault.kind`` of everything that a link reports; its source is the port or the device."""

    BROKEN = "broken"
    """The port went away."""
    REOPENED = "reopened"
    """The port is back: the end of BROKEN."""
    SILENT = "silent"
    """A device stopped to answer."""
    REFUSED = "refused"
    """A device answers that it will not give its readings."""
    ANSWERING = "answering"
    """A device answers again: the end of SILENT or REFUSED."""
    RESTARTED = "restarted"
    """A device has restarted by itself; a drive is then off."""
    NOT_STARTED = "not-started"
    """A device could not be set up again after an interruption; it is tried again."""
    MALFORMED = "malformed"
    """Frames or bytes came that make no sense: a bad checksum, a bad length, bad hex."""
    LATE = "late"
    """A reply came after its request had been given up; it was discarded."""
    BUS_ERROR = "bus-error"
    """The CAN controller reports an error frame."""
    EMERGENCY = "emergency"
    """A device reports an error of its own (CANopen EMCY)."""


@dataclass(slots=True)
class _Repeats:
    latest: Fault
    reported_ns: int
    unreported: int = 0


class FaultThrottle:
    """Lets the first fault of a kind through, then one summary a second while it repeats.

    A noisy line can produce thousands of faults a second; all are counted, few are written.
    """

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], _Repeats] = {}

    def offer(self, fault: Fault) -> list[Fault]:
        """The faults to report now that ``fault`` has happened: itself, or none yet."""
        key = (fault.source, fault.kind)
        repeats = self._seen.get(key)
        if repeats is None:
            self._seen[key] = _Repeats(fault, fault.time_ns)
            return [fault]
        repeats.latest = fault
        repeats.unreported += 1
        return []

    def due(self, now_ns: int) -> list[Fault]:
        """Summaries that are due, of what repeated since it was last reported."""
        summaries = []
        for key, repeats in list(self._seen.items()):
            if now_ns - repeats.reported_ns < SECOND:
                continue
            if repeats.unreported == 0:
                del self._seen[key]
                continue
            last = repeats.latest
            text = f"{repeats.unreported} more times; the last: {last.text}"
            summaries.append(Fault(now_ns, last.source, last.kind, text))
            repeats.reported_ns, repeats.unreported = now_ns, 0
        return summaries
