"""A session that runs: its parts, and the order in which they begin and end.

Sampling begins first and ends last. In between the plan is executed and recorded, and
whatever ends it, the drives go to safe mode before anything else is closed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from daq.arming import Arming
from daq.by_hand import ByHandPlan
from daq.clock import SECOND, Clock
from daq.device_clocks import DeviceClocks
from daq.driven import DrivenPlan
from daq.drives import Drives
from daq.errors import CannotRecord, NotReady, SessionFailed, StopRequested
from daq.event_queue import EventQueue
from daq.guard import Guard
from daq.interlocks import Interlocks
from daq.link_thread import LinkThread
from daq.live import LiveState
from daq.options import CaptureOptions
from daq.progress import Progress
from daq.recorder import Recorder
from daq.scale import scale_of
from daq.states import SessionStates, Step
from daq.stop import Stop
from daq.summary import CaptureSummary, Ending
from daq.supervision import TICK_S, Supervision
from drivers import DriverError, JointDrive, Link
from recordings.errors import RecordingError
from recordings.events import Event, Mark, Mode
from recordings.rig import Plan, Rig, Visit
from recordings.session import Session
from recordings.timing import DeviceTiming, timings
from recordings.writer import Writer


class RunningSession:
    """The parts of one session, and the order in which they begin and end."""

    def __init__(
        self,
        *,
        rig: Rig,
        plan: Plan,
        stops: Sequence[Visit],
        links: Sequence[Link],
        joints: dict[str, JointDrive],
        interlocks: Interlocks,
        arming: Arming | None,
        clock: Clock,
        stop: Stop,
        options: CaptureOptions,
    ) -> None:
        self._rig = rig
        self._plan = plan
        self._stops = stops
        self._clock = clock
        self._stop = stop
        self._options = options
        seconds = 2.0 + 2.0 * max(plan.dwell, plan.settle)
        self._live = LiveState(rig.channels, keep=max(64, round(seconds * plan.sample)))
        self._queue = EventQueue(options.queue_capacity)
        self._states = SessionStates(clock, lambda change: self._record([change]))
        self._drives = Drives(
            joints=joints,
            scales={joint: scale_of(rig, joint) for joint in plan.drives},
            states=self._states,
            interlocks=interlocks,
            seen=self._live.mode,
            clock=clock,
            record=lambda event: self._record([event]),
        )
        self._guard = Guard(
            rig=rig,
            plan=plan,
            states=self._states,
            drives=self._drives,
            interlocks=interlocks,
            arming=arming,
            live=self._live,
            record=lambda fault: self._record([fault]),
        )
        self._armed = "no real drive is moved"
        if arming is not None:
            self._armed = f"armed for {arming.valid_s:g} s, unless it is renewed"
        devices = {c.name: c.device for c in rig.channels if c.device is not None}
        self._clocks = [DeviceClocks(devices) for _ in links]
        self._links = [
            LinkThread(link, plan.sample, self._live, self._queue, clock, clocks)
            for link, clocks in zip(links, self._clocks, strict=True)
        ]

    def start(self) -> None:
        """Begin to sample, and wait until every channel has delivered.

        Raises:
            NotReady: a link could not start, or channels are silent; nothing samples any more.
            StopRequested: the operator asked to stop.
        """
        for link in self._links:
            link.start()
        try:
            self._await_channels()
        except BaseException:
            self._stop_links()
            raise

    def _await_channels(self) -> None:
        begin_ns = self._clock.now_ns()
        while silent := self._live.silent():
            if failures := [link for link in self._links if link.failure is not None]:
                raise NotReady([f"port '{link.name}': {link.failure}" for link in failures])
            if self._clock.wait(self._stop, TICK_S):
                raise StopRequested("stopped before anything was recorded")
            if self._clock.now_ns() - begin_ns > self._options.live_timeout_s * SECOND:
                raise NotReady([self._silence(name) for name in silent])

    def _silence(self, channel: str) -> str:
        device = self._rig.channel(channel).device
        faults = [fault.text for fault in self._live.faults if fault.source in (channel, device)]
        said = f" ({faults[-1]})" if faults else ""
        return (
            f"channel '{channel}' of device '{device}': no usable reading within "
            f"{self._options.live_timeout_s:g} s{said}"
        )

    def record(
        self,
        path: Path,
        rig_toml: str,
        metadata: Session,
        on_progress: Callable[[Progress], None],
    ) -> CaptureSummary:
        """Create the file, execute the plan, end safely.

        Raises:
            CannotRecord: the file cannot be created; nothing samples any more.
        """
        try:
            writer = Writer(path, rig_toml, metadata, self._options.storage)
        except BaseException as error:
            self._stop_links()
            if isinstance(error, RecordingError):
                raise CannotRecord(str(error)) from error
            raise
        recorder = Recorder(writer, self._queue, self._clock)
        recorder.start()
        supervision = Supervision(
            rig=self._rig,
            plan=self._plan,
            stops=len(self._stops),
            clock=self._clock,
            stop=self._stop,
            live=self._live,
            queue=self._queue,
            links=self._links,
            recorder=recorder,
            states=self._states,
            guard=self._guard,
            on_progress=on_progress,
            max_duration_s=self._options.max_duration_s,
        )
        ending, why = Ending.FAILED, "a fault of the program itself"
        cause: Exception | None = None
        expected = False
        try:
            try:
                self._execute(supervision)
                ending, why = Ending.COMPLETE, ""
            except StopRequested as request:
                ending, why = Ending.STOPPED, str(request)
            except (SessionFailed, DriverError) as failure:
                why, cause = str(failure), failure
            expected = True
        finally:
            try:
                self._make_safe(f"session {ending}: {why}" if why else f"session {ending}")
                # A display may hang or fail: nothing waits for it before the drives are off.
                if expected:
                    supervision.show_stopping()
            finally:
                self._drives.close()
                self._stop_links()
                self._queue.close()
                recorder.join()
        if recorder.failure is not None and ending is not Ending.FAILED:
            ending, why, cause = Ending.FAILED, str(recorder.failure), recorder.failure
        return CaptureSummary(
            path=path,
            parts=len(writer.paths),
            ending=ending,
            why=why,
            duration_s=(self._clock.now_ns() - supervision.start_ns) / SECOND,
            stops=len(self._stops),
            dwells=supervision.dwells,
            ledger=recorder.ledger,
            faults=self._live.faults,
            states=self._states.changes,
            timing=self._timing(),
            error=cause,
        )

    def _execute(self, supervision: Supervision) -> None:
        drives = self._drives
        drives.supervise_by(supervision.tick)
        supervision.step(Step.ARM, self._armed)
        if self._plan.mode == "driven":
            plan = DrivenPlan(
                self._rig, self._plan, self._stops, drives, supervision, self._options
            )
            plan.run()
            return
        for joint in drives.joints:
            drives.set_mode(joint, Mode.OFF, "before the plan")
            drives.set_mode(joint, Mode.FREE, "moved by hand")
        ByHandPlan(self._plan, len(self._stops), supervision).run()

    def _make_safe(self, cause: str) -> None:
        self._states.take(Step.MAKE_SAFE, cause)
        if self._drives.make_safe(cause):
            self._states.take(Step.RESET, "every drive has answered that it is off")
        self._record([Mark(self._clock.now_ns(), cause)])

    def _timing(self) -> tuple[DeviceTiming, ...]:
        """What is known of the times of each device in the end."""
        known = [clocks.known for clocks in self._clocks]
        return timings(
            self._rig,
            [sample for samples, _ in known for sample in samples],
            [trip for _, trips in known for trip in trips],
        )

    def _record(self, events: Sequence[Event]) -> None:
        """Put events of the session itself on their way to the file."""
        self._live.observe(events)
        self._queue.offer(events)

    def _stop_links(self) -> None:
        for link in self._links:
            link.stop()
        for link in self._links:
            link.join()
