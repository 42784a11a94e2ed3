"""The heartbeat of a node, as it shows that the node lives, and that there is only one. Pure."""

from __future__ import annotations

from collections import deque

from drivers.schedule import SECOND
from drivers.silence import SilenceWatch

BEAT_MS = 200
"""Time between two beats that a node is asked for (object 0x1017)."""

SILENT_NS = SECOND
"""How long no beat may come before the node is called silent: five beats."""

PAUSE_NS = SECOND // 2
"""A pause behind which beats may come that were held up."""

MOST_BEATS = 7
"""Beats that one node can be heard to make within a second, when its timer is a poor one."""


class BeatWatch(SilenceWatch):
    """Follows the beats of one node, once it is asked for them.

    Beats that were held up, in an adapter or because the host was, come at once; so those of a
    second after a pause are not counted.

    Attributes:
        doubled: whether they are those of two nodes.
    """

    def __init__(self) -> None:
        super().__init__(SILENT_NS)
        self.doubled = False
        self._heard_ns = 0
        self._void_until_ns = 0
        self._beats: deque[int] = deque()

    def begin(self, now_ns: int) -> None:
        """The node has been asked for beats; a node that cannot make them is not watched."""
        super().begin(now_ns)
        self._heard_ns = now_ns
        self._beats.clear()

    def hear(self, now_ns: int) -> bool:
        """A beat came; whether it ends a silence."""
        if self.expects:
            if now_ns - self._heard_ns > PAUSE_NS:
                self._void_until_ns = now_ns + SECOND
            self._heard_ns = now_ns
            if now_ns >= self._void_until_ns:
                self._beats.append(now_ns)
        return super().hear(now_ns)

    def doubles(self, now_ns: int) -> bool:
        """Whether `doubled` changes now."""
        while self._beats and now_ns - self._beats[0] >= SECOND:
            self._beats.popleft()
        most = MOST_BEATS - 1 if self.doubled else MOST_BEATS
        if now_ns < self._void_until_ns or self.doubled == (len(self._beats) > most):
            return False
        self.doubled = not self.doubled
        return True
