"""The time of a running session passes here, tick by tick, and nowhere else.

At every tick a session looks whether it may go on: whether the operator asked to stop, a
link or the file failed, a drive reports a fault, or the guard (`daq.guard`) objects. Whatever
moves or waits does so by ticking, so nothing can outrun a stop by more than `TICK_S`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from daq.clock import SECOND, Clock
from daq.errors import SessionFailed, StopRequested
from daq.event_queue import EventQueue
from daq.guard import Guard
from daq.link_thread import LinkThread
from daq.live import LiveState
from daq.progress import ChannelProgress, Phase, Progress
from daq.recorder import Recorder
from daq.standstill import Window, moving, restless
from daq.states import SessionStates, Step
from daq.stop import Stop
from recordings.events import Dwell, Event, Fault, Mode
from recordings.rig import Plan, Rig

TICK_S = 0.02
"""Time between two looks at the session [s]."""

PROGRESS_S = 0.2
"""Time between two snapshots of the progress [s]."""

LONGEST_GAP_S = 0.1
"""Time without a reading [s] after which a channel's standstill is not known, at fast sampling."""


class Supervision:
    """What a running session sees and records, and whether it may go on.

    Args:
        rig: the rig.
        plan: the plan being executed.
        stops: how many stops the plan asks for.
        clock: time of the session.
        stop: set when the operator asks to stop.
        live: latest state of channels and drives.
        queue: way to the file.
        links: the threads of the links.
        recorder: the thread that writes.
        states: state of the session.
        guard: judges drives and joints at every tick.
        on_progress: takes a snapshot every `PROGRESS_S`.
        max_duration_s: when to end of its own accord, or None.
    """

    def __init__(
        self,
        *,
        rig: Rig,
        plan: Plan,
        stops: int,
        clock: Clock,
        stop: Stop,
        live: LiveState,
        queue: EventQueue,
        links: Sequence[LinkThread],
        recorder: Recorder,
        states: SessionStates,
        guard: Guard,
        on_progress: Callable[[Progress], None],
        max_duration_s: float | None,
    ) -> None:
        self.live = live
        self._clock = clock
        self._stop = stop
        self._stops = stops
        self._queue = queue
        self._links = links
        self._recorder = recorder
        self._states = states
        self._guard = guard
        self._on_progress = on_progress
        self._max_duration_s = max_duration_s
        self._noise = {channel.name: channel.noise for channel in rig.channels}
        self._gap_ns = round(max(LONGEST_GAP_S, 5.0 / plan.sample) * SECOND)
        self._watched: dict[str, Mode] = {}
        self._watched_since_ns = 0
        self._start_ns = clock.now_ns()
        self._shown_ns = self._start_ns - round(PROGRESS_S * SECOND)
        self._phase = Phase.STARTING
        self._at = 0
        self._hint = ""
        self._dwells: list[Dwell] = []

    @property
    def start_ns(self) -> int:
        """When the recording began."""
        return self._start_ns

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """Dwells recorded so far."""
        return tuple(self._dwells)

    def now_ns(self) -> int:
        """Time of the session."""
        return self._clock.now_ns()

    def record(self, event: Event) -> None:
        """Put an event of the session itself on its way to the file."""
        if isinstance(event, Fault):
            self.live.observe([event])
        if isinstance(event, Dwell):
            self._dwells.append(event)
        self._queue.offer([event])

    def step(self, step: Step, cause: str) -> None:
        """Go on to another state; raises NotAllowed."""
        self._states.take(step, cause)

    def blind(self) -> bool:
        """Whether a joint has not been seen for so long that drives must not be led on."""
        return bool(self._guard.blind(self._clock.now_ns()))

    def watch_drives(self, modes: Mapping[str, Mode]) -> None:
        """From now on, a drive that leaves its mode here, or reports a fault, ends the session."""
        self._watched = dict(modes)
        self._watched_since_ns = self._clock.now_ns()

    def enter(self, phase: Phase, stop_number: int, hint: str) -> None:
        """Say what the session is doing, at which stop (from 1), and what comes next."""
        self._phase, self._at, self._hint = phase, stop_number, hint

    def show_stopping(self) -> None:
        """Show that the session ends; a slow disk can take a while to take the rest."""
        self.enter(Phase.STOPPING, self._at, "the drives are off; closing the file")
        self._on_progress(self.progress())

    def tick(self) -> int:
        """Let a moment pass; return the time [ns].

        Raises:
            StopRequested: the operator asked to stop, or the longest duration is reached.
            SessionFailed: a link, the file or a watched drive failed, or the guard objects.
        """
        self._clock.wait(self._stop, TICK_S)
        now_ns = self._clock.now_ns()
        if now_ns - self._shown_ns >= PROGRESS_S * SECOND:
            self._shown_ns = now_ns
            self._on_progress(self.progress())
        self._check(now_ns)
        return now_ns

    def moving(self, since_ns: int, until_ns: int) -> tuple[str, ...]:
        """Channels that moved in that time, or of which it is not known."""
        return moving(self.live.windows(), self._noise, since_ns, until_ns, self._gap_ns)

    def still(self, since_ns: int, until_ns: int) -> bool:
        """Whether no channel moved in that time, as far as is known."""
        found = restless(self.live.windows(), self._noise, since_ns, until_ns, self._gap_ns)
        return next(found, None) is None

    def windows(self, since_ns: int) -> dict[str, Window]:
        """Per channel, its samples from ``since_ns`` on."""
        return {name: window.since(since_ns) for name, window in self.live.windows().items()}

    @property
    def noise(self) -> dict[str, float]:
        """Per channel, standard deviation of one sample that the rig expects [counts]."""
        return self._noise

    def progress(self) -> Progress:
        """Snapshot of the session."""
        now_ns = self._clock.now_ns()
        ledger = self._recorder.ledger
        channels = []
        for name, rate_hz in self.live.rates(now_ns).items():
            entry = ledger.get(name)
            received = entry.received if entry else 0
            lost = entry.expected - entry.received if entry else 0
            channels.append(ChannelProgress(name, rate_hz, received, lost))
        faults = self.live.faults
        return Progress(
            phase=self._phase,
            stop=self._at,
            stops=self._stops,
            dwells=len(self._dwells),
            elapsed_s=(now_ns - self._start_ns) / SECOND,
            channels=tuple(channels),
            faults=self.live.fault_count,
            latest_fault=faults[-1] if faults else None,
            hint=self._hint,
            state=self._states.now,
            armed_s=None if self._guard.arming is None else self._guard.arming.left_s,
        )

    def _check(self, now_ns: int) -> None:
        if (error := self._recorder.must_end) is not None:
            raise SessionFailed("recording", f"the recording cannot go on: {error}") from error
        for link in self._links:
            if (failure := link.failure) is not None:
                text = f"{link.name}: {type(failure).__name__}: {failure}"
                raise SessionFailed(link.name, text) from failure
        if self._stop.is_set():
            raise StopRequested("the operator asked to stop")
        for joint, mode in self._watched.items():
            report = self.live.mode(joint)
            if report is None or report.time_ns < self._watched_since_ns or report.mode is mode:
                continue
            raise SessionFailed(
                joint,
                f"the drive of {joint} reports {report.mode.name} instead of {mode.name}: error code "
                f"0x{report.error_code:04X}, status word 0x{report.status:04X}; see the drive's "
                "manual, remove the cause and start again",
            )
        if (
            self._max_duration_s is not None
            and now_ns - self._start_ns >= self._max_duration_s * SECOND
        ):
            raise StopRequested(f"the longest duration of {self._max_duration_s:g} s is reached")
        self._guard.look(now_ns)
