"""Bytes on their way to a host that may not read: whole answers are lost, never parts of one."""

from __future__ import annotations

from collections.abc import Callable

from sim_devices.line import Line


class Outbox:
    """What ``line`` has answered and the host has not taken.

    Args:
        line: told when an answer is thrown away.
        most: bytes kept, beside what the kernel keeps.

    Attributes:
        lost_bytes: bytes thrown away because the host did not read.
    """

    def __init__(self, line: Line, most: int) -> None:
        self.lost_bytes = 0
        self._line = line
        self._most = most
        self._waiting = bytearray()

    def send(self, data: bytes, write: Callable[[bytearray], int]) -> None:
        """Put ``data`` behind what waits, and ``write`` what the host takes; raises what that does."""
        if data and len(self._waiting) + len(data) > self._most:
            self.lost_bytes += len(data)
            self._line.overrun()
        else:
            self._waiting += data
        if not self._waiting:
            return
        try:
            sent = write(self._waiting)
        except BlockingIOError:
            return
        del self._waiting[:sent]

    def clear(self) -> None:
        """The host has gone, and what it had not taken with it."""
        self._waiting.clear()
