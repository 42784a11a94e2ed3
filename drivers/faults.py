"""How often links repeat themselves when they report faults. Pure.

The kinds are those of `recordings.faults.FaultKind`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.schedule import SECOND
from recordings.events import Fault
from recordings.faults import ENDED_BY, FaultKind

QUIET_NS = SECOND
"""How long what repeats must be missing to be over; also the time between two summaries."""

_REPEATING = (FaultKind.MALFORMED, FaultKind.LATE, FaultKind.BUS_ERROR, FaultKind.FOREIGN)
OVER: Mapping[str, FaultKind] = {kind: ENDED_BY[kind] for kind in _REPEATING}
"""Kinds that are over when they have not repeated for a while, with the kind that says so."""


@dataclass(slots=True)
class _Repeats:
    latest: Fault
    began_ns: int
    reported_ns: int
    times: int = 1
    unreported: int = 0


class FaultThrottle:
    """Lets the first fault of a kind through, then one summary a second while it repeats, then its end.

    A noisy line can produce thousands of faults a second; all are counted, few are written.
    """

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], _Repeats] = {}
        self._looked_ns: int | None = None
        self._held_up = False

    def offer(self, fault: Fault) -> list[Fault]:
        """The faults to report now that ``fault`` has happened: itself, or none yet."""
        key = (fault.source, fault.kind)
        repeats = self._seen.get(key)
        if repeats is None:
            self._seen[key] = _Repeats(fault, fault.time_ns, fault.time_ns)
            return [fault]
        repeats.latest = fault
        repeats.times += 1
        repeats.unreported += 1
        return []

    def due(self, now_ns: int) -> list[Fault]:
        """What is due: summaries of what repeats, and the ends of what does not any more.

        To be asked in each turn of a link, before what has come is read.
        """
        looked_ns, self._looked_ns = self._looked_ns, now_ns
        late = looked_ns is not None and now_ns - looked_ns > QUIET_NS // 2
        self._held_up = late and not self._held_up
        if self._held_up:
            # Whether something has repeated meanwhile is still to be read.
            return []
        reports = []
        for key, repeats in list(self._seen.items()):
            last = repeats.latest
            if now_ns - last.time_ns >= QUIET_NS:
                del self._seen[key]
                if last.kind in OVER:
                    reports.append(self._end(repeats, now_ns))
            elif repeats.unreported and now_ns - repeats.reported_ns >= QUIET_NS:
                text = f"{repeats.unreported} more times; the last: {last.text}"
                reports.append(Fault(now_ns, last.source, last.kind, text))
                repeats.reported_ns, repeats.unreported = now_ns, 0
        return reports

    def _end(self, repeats: _Repeats, now_ns: int) -> Fault:
        last = repeats.latest
        lasted_s = (last.time_ns - repeats.began_ns) / SECOND
        times = "once" if repeats.times == 1 else f"{repeats.times} times in {lasted_s:.1f} s"
        text = (
            f"{last.kind} {times}, and not for {QUIET_NS / SECOND:g} s since; the last: {last.text}"
        )
        return Fault(now_ns, last.source, OVER[last.kind], text)
