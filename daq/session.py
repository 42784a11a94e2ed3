"""A capture session, from preflight to the closed recording.

Order of a session: look at path, plan and interlocks; open and ask every device; arm; sample,
until every channel has delivered; only then create the file, and only then move. However the
session ends, the drives go to safe mode first, then the links stop, then the file is
completed and closed. All threads have ended when `capture` returns or raises.
"""

from __future__ import annotations

import signal
import socket
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType

from daq.arming import Arming
from daq.by_hand import ByHandPlan
from daq.clock import SECOND, Clock, HostClock
from daq.device_clocks import DeviceClocks
from daq.driven import DrivenPlan
from daq.drives import Drives
from daq.errors import CannotRecord, NotReady, PlanNotPossible, SessionFailed, StopRequested
from daq.event_queue import EventQueue
from daq.guard import Guard
from daq.interlocks import Interlocks
from daq.link_thread import LinkThread
from daq.live import LiveState
from daq.mobility import Mobility, counted
from daq.options import CaptureOptions
from daq.preflight import arm_drives, check_path, check_plan, open_all
from daq.progress import Progress
from daq.recorder import Recorder
from daq.scale import scale_of
from daq.states import SessionStates, Step
from daq.summary import CaptureSummary, Ending
from daq.supervision import TICK_S, Supervision
from drivers import DriverError, JointDrive, Link, make_links
from recordings.errors import RecordingError
from recordings.events import Event, Mark, Mode
from recordings.rig import Plan, Rig, Visit, visits
from recordings.session import Session
from recordings.timing import DeviceTiming, timings
from recordings.writer import Writer


def _refuse(joints: tuple[str, ...]) -> bool:
    return False


def _ignore(progress: Progress) -> None:
    return None


def capture(
    rig: Rig,
    rig_toml: str,
    path: str | Path,
    *,
    links: Sequence[Link] | None = None,
    clock: Clock | None = None,
    arm: Callable[[tuple[str, ...]], bool] = _refuse,
    arming: Arming | None = None,
    arm_virtual: bool = False,
    mobility: Mobility | None = None,
    on_progress: Callable[[Progress], None] = _ignore,
    stop: threading.Event | None = None,
    operator: str = "",
    notes: str = "",
    plan_override: Plan | None = None,
    options: CaptureOptions | None = None,
) -> CaptureSummary:
    """Execute the plan of a rig and record it.

    SIGINT (Ctrl-C), SIGTERM and SIGHUP end the session like ``stop``, when called from the main
    thread: safe mode, complete file, summary. A second one changes nothing.

    Args:
        rig: the rig, as parsed from ``rig_toml``.
        rig_toml: the rig description, recorded exactly as it is.
        path: the recording to create; never replaced.
        links: links made for this rig and ``clock``; they are closed at the end. None makes
            them from the rig.
        clock: time of the session; None takes the host's.
        arm: asked for permission before the joints named are moved; only joints of drives
            that do not say that they are virtual. Refuses unless given.
        arming: how long that permission lasts, made for ``clock``, to be renewed by the operator
            or a live service. None takes the rig's ``arming_s``, and nobody renews it.
        arm_virtual: whether it may run out on virtual drives too.
        mobility: how the mechanism can move, which limits what may be held in position
            together; None counts joints and constraints.
        on_progress: takes a snapshot about five times a second, in the calling thread.
        stop: set it from anywhere to end the session.
        operator: who runs it, for the record.
        notes: free text, for the record.
        plan_override: plan to execute in place of the rig's.
        options: timeouts and limits.

    Returns:
        what was recorded and lost, and how the session ended: a failure after the recording
        began is an ending, not an exception.

    Raises:
        CannotRecord: the file exists already or cannot be created.
        NotReady: ports, devices or channels do not answer; all of them are named.
        PlanNotPossible: there is no plan, or it does not fit the rig.
        NotArmed: arming was refused.
        NotAllowed: a mistake of the program, after the session was made safe.
        StopRequested: stopped before the recording began.
        OptionError: a device's options do not fit its driver (from `drivers`).
    """
    plan = plan_override or rig.plan
    if plan is None:
        raise PlanNotPossible(f"the rig '{rig.name}' has no [plan]; add one, or give a plan")
    target = Path(path)
    options = options or CaptureOptions()
    check_path(target, options.storage)
    stops = visits(plan)
    interlocks = Interlocks(rig, mobility or counted(rig))
    check_plan(rig, plan, stops, interlocks)
    clock = clock or HostClock()
    stop = stop or threading.Event()
    links = make_links(rig, clock) if links is None else links
    with ExitStack() as closing:
        for link in links:
            closing.callback(link.close)
        statuses = open_all(links)
        joints = {joint: drive for link in links for joint, drive in link.joints.items()}
        arming = arming or Arming(clock, rig.interlocks.arming)
        limited = arm_drives(rig, joints, statuses, arm) or arm_virtual
        arming.grant()
        with _signals_set(stop):
            session = _Session(
                rig=rig,
                plan=plan,
                stops=stops,
                links=links,
                joints=joints,
                interlocks=interlocks,
                arming=arming if limited else None,
                clock=clock,
                stop=stop,
                options=options,
            )
            metadata = Session(
                session_id=uuid.uuid4().hex,
                start_ns=clock.now_ns(),
                operator=operator,
                notes=notes,
                host=socket.gethostname(),
            )
            session.start()
            return session.record(target, rig_toml, metadata, on_progress)


@contextmanager
def _signals_set(stop: threading.Event) -> Iterator[None]:
    """Let signals set ``stop``: an exception in the middle of a command would be unsafe."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.set()

    numbers = [signal.SIGINT, signal.SIGTERM]
    # A closed terminal hangs up, where there is such a signal, and unless `nohup` has said otherwise.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Session:
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
        stop: threading.Event,
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
