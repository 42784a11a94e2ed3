"""Whether two nodes answer under one id: more answers than requests. Pure.

An answer may come late, behind the next request, so a single surplus says nothing; several in
a short time do. A doubled id shows in nothing else: both nodes send valid frames. An adapter
that stalls gives what it kept in a burst; that is no surplus, because the requests were sent.
"""

from __future__ import annotations

from collections import deque

from drivers.schedule import SECOND

SURPLUS = 3
"""Answers beyond the requests, within `WINDOW_NS`, that cannot be late ones."""

WINDOW_NS = SECOND
LATEST_NS = 2 * SECOND
"""How late an answer may be; what has not come by then is lost, and hides a surplus no longer."""


class DoubleWatch:
    """Counts the answers of one node against the requests to it.

    Attributes:
        doubled: whether two nodes answer.
        surplus: whether the last answer was one too many.
        asked_ns: when the request was sent that the last answer belongs to, or an earlier one
            whose own was lost; None where it was one too many.
    """

    def __init__(self) -> None:
        self.doubled = False
        self.surplus = False
        self.asked_ns: int | None = None
        self._owed: deque[int] = deque()
        self._answered_ns: int | None = None
        self._void_until_ns = 0
        self._times: list[int] = []

    def ask(self, now_ns: int) -> bool:
        """A request was sent; whether this shows that only one node is left."""
        self._owed.append(now_ns)
        while now_ns - self._owed[0] > LATEST_NS:
            self._owed.popleft()
        if self.doubled and now_ns - self._times[-1] >= WINDOW_NS:
            self.doubled = False
            self._times = []
            return True
        return False

    def answer(self, now_ns: int) -> bool:
        """An answer came; whether this shows that there are two nodes now."""
        if self._answered_ns is not None and now_ns - self._answered_ns > LATEST_NS:
            # What comes at once behind such a pause answers requests that were taken for lost.
            self._void_until_ns = now_ns + WINDOW_NS
        self._answered_ns = now_ns
        self.surplus = not self._owed
        self.asked_ns = self._owed.popleft() if self._owed else None
        if not self.surplus or now_ns < self._void_until_ns:
            return False
        recent = [time_ns for time_ns in self._times if now_ns - time_ns < WINDOW_NS]
        self._times = [*recent[1 - SURPLUS :], now_ns]
        if self.doubled or len(self._times) < SURPLUS:
            return False
        self.doubled = True
        return True
