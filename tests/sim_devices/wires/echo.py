"""A far end for the tests of ports."""

from __future__ import annotations


class EchoLine:
    """A line that sends back what comes, says once what is due, and remembers what else happened."""

    def __init__(self) -> None:
        self.due = b""
        self.hang_ups = 0
        self.overruns = 0

    def receive(self, data: bytes, time_s: float) -> bytes:
        return data

    def tick(self, time_s: float) -> bytes:
        due, self.due = self.due, b""
        return due

    def hang_up(self) -> None:
        self.hang_ups += 1

    def overrun(self) -> None:
        self.overruns += 1
