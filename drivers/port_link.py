"""What the links of all kinds of port have around it: a port that is opened again, and whose turn it is.

One thread at a time holds the turn and serves the port. What it finds waits for the next
`PortLink.pump`. When the port goes away, it is opened again after growing delays (0.25 s to 4 s).
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Collection, Sequence

from drivers.errors import LinkClosed
from drivers.faults import FaultThrottle
from drivers.link import Clock
from drivers.outage import Outage, Reopenable
from drivers.tally import Tally
from recordings.events import Event, Fault
from recordings.faults import FaultKind


class PortLink(ABC):
    """The part of a `drivers.link.Link` that does not depend on what is on its port.

    Args:
        name: port name of the rig.
        port: what to open, and to open again.
        clock: time of the session.
        tallies: of all channels that come through the port at the instants of a schedule.
    """

    def __init__(
        self, name: str, port: Reopenable, clock: Clock, tallies: Collection[Tally] = ()
    ) -> None:
        self.name = name
        self._port = port
        self._clock = clock
        self._turn = threading.Lock()
        self._closing = threading.Event()
        self._closing.set()
        self._outage = Outage(name, port, tallies, clock, self._closing)
        self._pending: deque[Event] = deque()
        self._throttle = FaultThrottle()

    def open(self) -> None:
        """Open the port; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        with self._turn:
            self._port.open()
            self._outage.end()
            self._opened()
            self._closing.clear()

    def pump(self, timeout_s: float) -> Sequence[Event]:
        """Serve the port for one turn; raises LinkClosed."""
        self._require_open()
        with self._turn:
            self._serve(timeout_s)
            return self._taken()

    def close(self) -> None:
        """Let the port go."""
        self._closing.set()
        with self._turn:
            self._end_sampling()
            self._port.close()

    def fault(self, time_ns: int, source: str, kind: FaultKind, text: str) -> None:
        """Report a fault; repeated ones are summed up. Called in a turn."""
        self._pending.extend(self._throttle.offer(Fault(time_ns, source, kind, text)))

    def _opened(self) -> None:  # noqa: B027
        """The port has been opened by the program; called in a turn."""

    @abstractmethod
    def _serve(self, timeout_s: float) -> None:
        """One turn: wait at most ``timeout_s``, keep what comes for `pump`."""

    @abstractmethod
    def _end_sampling(self) -> None:
        """Nothing is asked for any more; called in a turn."""

    def _taken(self) -> list[Event]:
        """What waits for `pump`; called in a turn."""
        events = list(self._pending)
        self._pending.clear()
        return events

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise LinkClosed(f"port '{self.name}' is not open; call open() first")
