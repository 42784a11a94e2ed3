"""Arming: the operator's permission to move the joints, for a while.

It ends by itself unless it is renewed, so that a mechanism does not go on moving when whoever
armed it has left, or the service that stands in for them has died. Once it has ended it cannot
be renewed: the session goes safe.
"""

from __future__ import annotations

import threading

from daq.clock import SECOND, Clock


class Arming:
    """Permission that lasts ``valid_s`` from when it is granted or was last renewed. Any thread may use it.

    Args:
        clock: time of the session.
        valid_s: how long it lasts [s], above 0.
    """

    def __init__(self, clock: Clock, valid_s: float) -> None:
        if not valid_s > 0:
            raise ValueError(f"valid_s is {valid_s}, expected above 0")
        self._clock = clock
        self.valid_s = valid_s
        self._lock = threading.Lock()
        self._until_ns: int | None = None

    def grant(self) -> None:
        """The operator has armed."""
        with self._lock:
            self._until_ns = self._clock.now_ns() + round(self.valid_s * SECOND)

    def renew(self) -> bool:
        """The operator, or a live service, is still there; whether that was in time."""
        with self._lock:
            now_ns = self._clock.now_ns()
            if self._until_ns is None or now_ns >= self._until_ns:
                return False
            self._until_ns = now_ns + round(self.valid_s * SECOND)
            return True

    @property
    def left_s(self) -> float:
        """How long it still lasts [s]; 0 when it has ended or was never granted."""
        with self._lock:
            if self._until_ns is None:
                return 0.0
            return max(0.0, (self._until_ns - self._clock.now_ns()) / SECOND)
