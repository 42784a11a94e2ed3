"""Whether a bus or line is filled with what nobody asked for. Pure."""

from __future__ import annotations

from drivers.schedule import SECOND

WINDOW_NS = SECOND // 4
QUIET_NS = SECOND
"""How long it must be quiet for a babble to be over."""


class BabbleWatch:
    """Counts what nobody asked for, in windows of `WINDOW_NS`.

    Args:
        limit_hz: rate above which it is called babble.

    Attributes:
        babbling: whether it is.
        rate_hz: rate in the last window.
    """

    def __init__(self, limit_hz: float) -> None:
        self.limit_hz = limit_hz
        self.babbling = False
        self.rate_hz = 0.0
        self._count = 0
        self._window_ns: int | None = None
        self._loud_ns = 0

    def hear(self, count: int) -> None:
        """So much has come that nobody asked for."""
        self._count += count

    def changes(self, now_ns: int) -> bool:
        """Whether `babbling` changes now; to be asked regularly."""
        if self._window_ns is None:
            self._window_ns, self._count = now_ns, 0
        passed_ns = now_ns - self._window_ns
        if passed_ns < WINDOW_NS:
            return False
        self.rate_hz = self._count * SECOND / passed_ns
        self._window_ns, self._count = now_ns, 0
        if self.rate_hz > self.limit_hz:
            self._loud_ns = now_ns
            loud = True
        else:
            loud = self.babbling and now_ns - self._loud_ns < QUIET_NS
        changed, self.babbling = loud != self.babbling, loud
        return changed
