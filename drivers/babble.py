"""Whether a bus or line is filled with what nobody asked for, and how that is told. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.schedule import SECOND
from recordings.events import Fault
from recordings.faults import FaultKind

WINDOW_NS = SECOND // 4
QUIET_NS = SECOND
"""How long it must be quiet for a babble to be over."""


@dataclass(frozen=True, slots=True)
class Babble:
    """How a babble is told.

    Attributes:
        source: port name of the rig.
        where: what is filled, such as "bus".
        what: what fills it, as it is counted.
        cause: where that likely comes from.
    """

    source: str
    where: str
    what: str
    cause: str


class BabbleWatch:
    """Counts what nobody asked for, in windows of `WINDOW_NS`.

    Args:
        babble: how it is told.
        limit_hz: rate above which it is called babble.
    """

    def __init__(self, babble: Babble, limit_hz: float) -> None:
        self._babble = babble
        self._limit_hz = limit_hz
        self._babbling = False
        self._count = 0
        self._window_ns: int | None = None
        self._due_ns = 0
        self._extended = False
        self._loud_ns = 0

    def hear(self, count: int) -> None:
        """So much has come that nobody asked for."""
        self._count += count

    def look(self, now_ns: int) -> Sequence[Fault]:
        """The fault that begins or ends now, if one does; to be asked regularly."""
        if self._window_ns is None:
            self._begin_window(now_ns)
            return ()
        if now_ns < self._due_ns:
            return ()
        if now_ns - self._due_ns > WINDOW_NS and not self._extended:
            # The host was held up: what came meanwhile is still to be read, and belongs here.
            self._extended, self._due_ns = True, now_ns + WINDOW_NS
            return ()
        rate_hz = self._count * SECOND / (now_ns - self._window_ns)
        self._begin_window(now_ns)
        if rate_hz > self._limit_hz:
            self._loud_ns = now_ns
            loud = True
        else:
            loud = self._babbling and now_ns - self._loud_ns < QUIET_NS
        if loud == self._babbling:
            return ()
        self._babbling = loud
        return (self._begins(now_ns, rate_hz) if loud else self._ends(now_ns),)

    def _begin_window(self, now_ns: int) -> None:
        self._window_ns, self._due_ns = now_ns, now_ns + WINDOW_NS
        self._extended = False
        self._count = 0

    def _begins(self, now_ns: int, rate_hz: float) -> Fault:
        babble = self._babble
        text = f"{rate_hz:.0f} {babble.what}, above {self._limit_hz:.0f}: {babble.cause}"
        return Fault(now_ns, babble.source, FaultKind.BABBLE, text)

    def _ends(self, now_ns: int) -> Fault:
        text = f"the {self._babble.where} is quiet again"
        return Fault(now_ns, self._babble.source, FaultKind.QUIET, text)
