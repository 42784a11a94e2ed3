"""What a link does while its port is away: try to open it, wait in between, count what is lost.

Attempts follow growing delays (`drivers.schedule.Backoff`); between them the caller's thread
waits, so that an absent adapter costs no processor time. A port that breaks again soon after it
came back (a loose plug, a bus that stays off) goes on with the delay that it had reached.
"""

from __future__ import annotations

import threading
from collections.abc import Collection
from typing import Protocol

from drivers.errors import BusOff, DriverError, LinkBroken
from drivers.link import Clock
from drivers.schedule import SECOND, Backoff
from drivers.tally import Tally
from drivers.waiting import LONGEST_WAIT_S
from recordings.events import Fault
from recordings.faults import FaultKind

STEADY_NS = 5 * SECOND
"""How long a port must have been open again for its next outage to begin with a short delay."""


class Reopenable(Protocol):
    """What can be opened and closed again and again."""

    def open(self) -> None:
        """Open it; raises DriverError."""
        ...

    def close(self) -> None:
        """Let it go; harmless when it is not open."""
        ...


class Outage:
    """The outages of one port.

    Args:
        name: port name of the rig.
        port: what to open again.
        tallies: of all channels that come through the port.
        clock: time of the session.
        closing: set when the link is being closed; ends a wait.
    """

    def __init__(
        self,
        name: str,
        port: Reopenable,
        tallies: Collection[Tally],
        clock: Clock,
        closing: threading.Event,
    ) -> None:
        self._name = name
        self._port = port
        self._tallies = tallies
        self._clock = clock
        self._closing = closing
        self._backoff = Backoff(0)
        self._away = False
        self._since_ns = 0
        self._reopened_ns: int | None = None

    @property
    def lasts(self) -> bool:
        """Whether the port is away."""
        return self._away

    def begin(self, error: LinkBroken, *, sampling: bool) -> Fault:
        """The port has gone away; returns what to report."""
        self._since_ns = self._clock.now_ns()
        self._port.close()
        self._away = True
        if self._reopened_ns is not None and self._since_ns - self._reopened_ns < STEADY_NS:
            self._backoff.failed(self._since_ns)
        else:
            self._backoff = Backoff(self._since_ns)
        if sampling:
            for tally in self._tallies:
                tally.begin_gap()
        kind = FaultKind.BUS_OFF if isinstance(error, BusOff) else FaultKind.BROKEN
        return Fault(self._since_ns, self._name, kind, str(error))

    def serve(self, missed: int, timeout_s: float) -> Fault | None:
        """One turn of an outage: try to open the port if it is time, else wait.

        Args:
            missed: samples that fell due since the last turn.
            timeout_s: longest wait [s].

        Returns:
            What to report once the port is open again, else None.
        """
        for tally in self._tallies:
            tally.lose(missed)
        now_ns = self._clock.now_ns()
        if not self._away:
            return None
        if now_ns < self._backoff.next_ns:
            wait_s = (self._backoff.next_ns - now_ns) / SECOND
            self._closing.wait(min(timeout_s, LONGEST_WAIT_S, wait_s))
            return None
        try:
            self._port.open()
        except DriverError:
            # Still away. BROKEN has been reported; what it costs is counted, not repeated.
            self._backoff.failed(self._clock.now_ns())
            return None
        self.end()
        now_ns = self._reopened_ns = self._clock.now_ns()
        away_s = (now_ns - self._since_ns) / SECOND
        text = f"port '{self._name}' is open again after {away_s:.1f} s"
        return Fault(now_ns, self._name, FaultKind.REOPENED, text)

    def end(self) -> None:
        """The port is open."""
        self._away = False
