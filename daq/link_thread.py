"""One thread a link: it starts the link, pumps it, and stops it.

Everything a link does on its port between `start` and `stop` happens in this thread. What
comes is shown to the live state first, tells of the clocks of devices, and is queued for the
file. An exception ends the thread, not the process: it is kept for the session, which ends in
safe mode and names the link.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence

from daq.clock import SECOND, Clock
from daq.device_clocks import DeviceClocks
from daq.event_queue import Checkpoint, EventQueue
from daq.live import LiveState
from drivers import DriverError, Link
from recordings.events import Event, Fault

PUMP_S = 0.02
"""How long one `pump` may wait for something to come [s]."""

CHECKPOINT_S = 0.1
"""Time between two checkpoints of the losses [s]."""


class LinkThread:
    """Runs one link from its start to its stop."""

    def __init__(
        self,
        link: Link,
        sample_hz: float,
        live: LiveState,
        queue: EventQueue,
        clock: Clock,
        clocks: DeviceClocks,
    ) -> None:
        self._link = link
        self._sample_hz = sample_hz
        self._live = live
        self._queue = queue
        self._clock = clock
        self._clocks = clocks
        self._dropped: Counter[str] = Counter()
        self._stop = threading.Event()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name=f"loopcal-link-{link.name}")

    @property
    def name(self) -> str:
        """Name of the link."""
        return self._link.name

    @property
    def failure(self) -> Exception | None:
        """What ended the thread early, or None."""
        return self._failure

    def start(self) -> None:
        """Begin to sample."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to stop the link and to deliver what is left."""
        self._stop.set()

    def join(self) -> None:
        """Wait until the thread has ended, if it was ever started."""
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            self._link.start(self._sample_hz)
            self._pump()
        except Exception as error:  # noqa: BLE001 - the end of a thread: whatever it is, the session must end safely
            self._failed("link-failed", error)
        try:
            self._link.stop()
            if self._failure is None:
                self._deliver(self._link.pump(0.0))
        except DriverError as error:
            self._failed("stop-failed", error)
        self._checkpoint()

    def _pump(self) -> None:
        balanced_ns = self._clock.now_ns()
        while not self._stop.is_set():
            self._deliver(self._link.pump(PUMP_S))
            now_ns = self._clock.now_ns()
            if now_ns - balanced_ns >= CHECKPOINT_S * SECOND:
                self._checkpoint()
                balanced_ns = now_ns

    def _deliver(self, events: Sequence[Event]) -> None:
        self._live.observe(events)
        if said := self._clocks.follow(events):
            events = [*events, *said]
        self._dropped.update(self._queue.offer(events))

    def _checkpoint(self) -> None:
        self._queue.offer([Checkpoint(self._link.losses(), dict(self._dropped))])

    def _failed(self, kind: str, error: Exception) -> None:
        if self._failure is None:
            self._failure = error
        text = f"{type(error).__name__}: {error}"
        self._deliver([Fault(self._clock.now_ns(), self.name, kind, text)])
