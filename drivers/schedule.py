"""When to do what: instants at a rate, and growing delays between attempts. Knows no clock.

An instant is computed from its number, not from the instant before, so that neither
rounding nor late service accumulates.
"""

from __future__ import annotations

SECOND = 1_000_000_000


PATIENCE_S = 0.1
"""Instants at most this late are still served, in a row; what is later is given up."""


class Schedule:
    """The instants start, start + 1/rate, start + 2/rate, ...

    A host that was held up for some milliseconds takes the samples then, each with the time
    at which it really came, rather than losing them.

    Args:
        rate_hz: instants a second, above 0.
        start_ns: the first instant.
    """

    def __init__(self, rate_hz: float, start_ns: int) -> None:
        if not rate_hz > 0:
            raise ValueError(f"rate_hz is {rate_hz}, expected above 0")
        self._period_ns = SECOND / rate_hz
        self._start_ns = start_ns
        self._served = 0
        self._patience = int(PATIENCE_S * rate_hz)

    @property
    def next_ns(self) -> int:
        """The first instant that has not been served."""
        return self._instant(self._served)

    def due(self, now_ns: int) -> int:
        """How many instants end with this call: 0 when none has come, 1 to serve one, more when the older ones are given up."""
        if now_ns < self.next_ns:
            return 0
        reached = int((now_ns - self._start_ns) / self._period_ns)
        while self._instant(reached + 1) <= now_ns:
            reached += 1
        while self._instant(reached) > now_ns:
            reached -= 1
        waiting = reached + 1 - self._served
        count = max(1, waiting - self._patience)
        self._served += count
        return count

    def _instant(self, number: int) -> int:
        return self._start_ns + round(number * self._period_ns)


class Backoff:
    """When to try again: each failure doubles the delay, up to a cap.

    Args:
        now_ns: time of the first failure.
        first_s: delay after it [s].
        cap_s: longest delay [s].
    """

    def __init__(self, now_ns: int, first_s: float = 0.25, cap_s: float = 4.0) -> None:
        self._delay_s = first_s
        self._cap_s = cap_s
        self._next_ns = now_ns
        self.failed(now_ns)

    @property
    def next_ns(self) -> int:
        """Time of the next attempt."""
        return self._next_ns

    def failed(self, now_ns: int) -> None:
        """An attempt failed at ``now_ns``."""
        self._next_ns = now_ns + round(self._delay_s * SECOND)
        self._delay_s = min(2 * self._delay_s, self._cap_s)
