"""How long a device takes to answer, told once a second: between the two its readings were taken. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.schedule import SECOND
from recordings.events import RoundTrip


class RoundTrips:
    """The answers of one device.

    Args:
        source: device name of the rig.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._since_ns: int | None = None
        self._shortest_ns = 0
        self._longest_ns = 0

    def answered(self, asked_ns: int | None, time_ns: int) -> Sequence[RoundTrip]:
        """An answer to a request of ``asked_ns`` (None: nobody asked) came; what is to be told now."""
        if asked_ns is None:
            return ()
        trip_ns = time_ns - asked_ns
        if self._since_ns is None:
            self._since_ns, self._shortest_ns, self._longest_ns = time_ns, trip_ns, trip_ns
        self._shortest_ns = min(self._shortest_ns, trip_ns)
        self._longest_ns = max(self._longest_ns, trip_ns)
        if time_ns - self._since_ns < SECOND:
            return ()
        self._since_ns = None
        return (RoundTrip(self._source, time_ns, self._shortest_ns, self._longest_ns),)
