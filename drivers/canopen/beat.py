"""The heartbeat of a node, as it shows that the node lives, and that there is only one. Pure."""

from __future__ import annotations

from collections import deque

from drivers.schedule import SECOND

BEAT_MS = 200
"""Time between two beats that a node is asked for (object 0x1017)."""

SILENT_NS = SECOND
"""How long no beat may come before the node is called silent: five beats."""

MOST_BEATS = 7
"""Beats that one node can be heard to make within a second, when its timer is a poor one."""


class BeatWatch:
    """Follows the beats of one node, once it is asked for them.

    Attributes:
        silent: whether they have stopped.
        doubled: whether they are those of two nodes.
    """

    def __init__(self) -> None:
        self.silent = False
        self.doubled = False
        self._heard_ns: int | None = None
        self._looked_ns = 0
        self._beats: deque[int] = deque()

    def begin(self, now_ns: int) -> None:
        """The node has been asked for beats; a node that cannot make them is not watched."""
        self._heard_ns = now_ns
        self._beats.clear()

    def end(self) -> None:
        """The node cannot be heard for another reason."""
        self._heard_ns = None

    def hear(self, now_ns: int) -> bool:
        """A beat came; whether it ends a silence."""
        if self._heard_ns is None:
            return False
        self._heard_ns = now_ns
        self._beats.append(now_ns)
        ended, self.silent = self.silent, False
        return ended

    def falls_silent(self, now_ns: int) -> bool:
        """Whether it is silent from now on."""
        held_up, self._looked_ns = now_ns - self._looked_ns > SILENT_NS // 2, now_ns
        if self._heard_ns is None or self.silent:
            return False
        if held_up:
            # Nobody has listened: what the node said meanwhile is still to be read.
            self._heard_ns = now_ns
        if now_ns - self._heard_ns <= SILENT_NS:
            return False
        self.silent = True
        return True

    def doubles(self, now_ns: int) -> bool:
        """Whether `doubled` changes now."""
        while self._beats and now_ns - self._beats[0] >= SECOND:
            self._beats.popleft()
        most = MOST_BEATS - 1 if self.doubled else MOST_BEATS
        if self.doubled == (len(self._beats) > most):
            return False
        self.doubled = not self.doubled
        return True
