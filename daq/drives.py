"""The joint drives of a session: every command is judged, recorded with its cause, and given.

Commands are judged here and nowhere else, before they reach a wire: the session's state and
the rig's interlocks can refuse. A drive may take seconds to obey or not to answer; it is told
in a thread of its own, so that the session goes on looking after the others meanwhile.

Owns the way back to safe mode: all drives are told to be off at the same time, whatever one of
them does or an exception says. Drives are off, not held: joints that nobody supervises must not
over-constrain a closed loop. A drive that does not answer in time is told again, since an
answer can be late on a busy bus and every command may be repeated without harm; each time is
recorded as a fault.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

from daq.clock import SECOND, Clock
from daq.errors import Interlocked, NotAllowed
from daq.interlocks import Interlocks
from daq.scale import Scale
from daq.states import SessionStates
from drivers import DeviceSilent, JointDrive
from recordings.events import Event, Fault, Mode, ModeCommand, ModeReport

_T = TypeVar("_T")

ATTEMPTS = 3
"""How often a drive that does not answer is told a command."""

AHEAD_S = 0.1
"""How much sooner drives that hold their joints are switched off than the others [s]."""

LONGEST_OFF_S = 15.0
"""How long a drive may take to be switched off [s]; then its watchdog must do it."""

ASK_S = 0.5
"""Time between two questions to a drive how it is [s]; one that reports by itself answers at once."""

UNANSWERED = 2
"""Questions in a row without an answer after which a drive is lost."""

WATCH_S = 0.02
"""How long a command may take before the session looks after everything else [s]."""


class Drives:
    """All joint drives of a rig. Commands come from one thread.

    Args:
        joints: drive of each joint.
        scales: meaning of the counts of each joint that may be sent to targets.
        states: state of the session; says what may be commanded now.
        interlocks: what may never be commanded.
        seen: latest report of a joint's drive, or None before the first.
        clock: time of the session.
        record: takes every command, and every fault.
    """

    def __init__(
        self,
        *,
        joints: Mapping[str, JointDrive],
        scales: Mapping[str, Scale],
        states: SessionStates,
        interlocks: Interlocks,
        seen: Callable[[str], ModeReport | None],
        clock: Clock,
        record: Callable[[Event], None],
    ) -> None:
        self._joints = dict(joints)
        self._scales = scales
        self._states = states
        self._interlocks = interlocks
        self._seen = seen
        self._clock = clock
        self._record = record
        self._told: dict[str, Mode] = {}
        self._answered_ns: dict[str, int] = {}
        self._targets: dict[str, tuple[float, int]] = {}
        self._stuck: set[str] = set()
        self._questions: dict[str, tuple[int, Future[ModeReport]]] = {}
        self._unanswered: Counter[str] = Counter()
        self._ending = threading.Event()
        self._meanwhile: Callable[[], object] = lambda: None
        self._threads = {
            joint: ThreadPoolExecutor(1, f"loopcal-drive-{joint}") for joint in self._joints
        }

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that have a drive."""
        return tuple(self._joints)

    def supervise_by(self, look: Callable[[], object]) -> None:
        """While a command takes long, ``look`` is called over and over; what it raises ends the wait."""
        self._meanwhile = look

    def vouch(self, until_ns: int) -> None:
        """The session supervises, and drives need not trip before ``until_ns``."""
        for drive in self._joints.values():
            drive.vouch(until_ns)

    def set_mode(self, joint: str, mode: Mode, cause: str) -> None:
        """Command a mode; raises NotAllowed, Interlocked, DriverError, or what supervising raises."""
        self._states.require_mode(joint, mode)
        self._require(joint, self._interlocks.of_mode(joint, mode, self._worst_modes()))
        if mode is not Mode.OFF:
            # Until it has answered otherwise it may be in either: the stricter one counts.
            before = self._told.get(joint)
            self._told[joint] = Mode.POSITION if before is Mode.POSITION else mode
        self._record(ModeCommand(joint, self._clock.now_ns(), mode, None, cause))
        self._insist(joint, lambda drive: drive.set_mode(mode))
        self._told[joint] = mode
        self._answered_ns[joint] = self._clock.now_ns()
        self._targets.pop(joint, None)

    def move_to(self, joint: str, target_raw: int, cause: str) -> None:
        """Command a target of position mode, in counts of the sensing channel; raises as `set_mode`."""
        self._states.require_target(joint)
        if joint not in self._targets:
            raise NotAllowed(f"{joint} was to be sent to a target, but nobody said where it holds")
        now_ns = self._clock.now_ns()
        target = self._scales[joint].value(target_raw)
        last, since_ns = self._targets[joint]
        seconds = (now_ns - since_ns) / SECOND
        self._require(joint, self._interlocks.of_target(joint, target, last, seconds))
        self._targets[joint] = (target, now_ns)
        self._record(ModeCommand(joint, now_ns, Mode.POSITION, target_raw, cause))
        self._insist(joint, lambda drive: drive.move_to(target_raw))

    def hold_at(self, joint: str, value: float) -> None:
        """``joint`` holds at ``value`` [rad or m] now: where its next target is counted from."""
        self._targets[joint] = (value, self._clock.now_ns())

    def set_torque(self, joint: str, permille: int, cause: str) -> None:
        """Command a torque [per mille of rated]; raises as `set_mode`."""
        self._states.require_target(joint)
        self._require(joint, self._interlocks.of_torque(joint, permille))
        self._record(ModeCommand(joint, self._clock.now_ns(), Mode.TORQUE, permille, cause))
        self._insist(joint, lambda drive: drive.set_torque(permille))

    def report(self, joint: str) -> ModeReport:
        """What the drive says it is doing; raises DriverError, or what supervising raises."""
        return self._wait(self._threads[joint].submit(self._joints[joint].report))

    def lost(self, now_ns: int) -> str:
        """Why a drive is taken to be lost, "" while all answer. Asks them now and then; never waits."""
        for joint, thread in self._threads.items():
            asked = self._questions.get(joint)
            if asked is not None and (
                not asked[1].done() or now_ns - asked[0] < round(ASK_S * SECOND)
            ):
                continue
            if asked is not None and (error := asked[1].exception()) is not None:
                self._unanswered[joint] += 1
                self._record(Fault(now_ns, joint, "no-answer", str(error)))
                if self._unanswered[joint] >= UNANSWERED or not isinstance(error, DeviceSilent):
                    return f"the drive of {joint} does not say how it is: {error}"
            else:
                self._unanswered[joint] = 0
            self._questions[joint] = (now_ns, thread.submit(self._joints[joint].report))
        return ""

    def make_safe(self, cause: str) -> bool:
        """Switch every drive off, those in position mode first; whether all have answered.

        What fails is recorded as a fault and never raised. No earlier command is given any more.
        """
        self._ending.set()
        holding = [joint for joint in self._joints if self._told.get(joint) is Mode.POSITION]
        others = [joint for joint in self._joints if joint not in holding]
        ends: dict[str, Future[None]] = {}
        for joints in (holding, others):
            for joint in joints:
                self._record(ModeCommand(joint, self._clock.now_ns(), Mode.OFF, None, cause))
                ends[joint] = self._threads[joint].submit(self._switch_off, joint)
            wait(ends.values(), AHEAD_S)
        wait(ends.values(), LONGEST_OFF_S)
        answered = [self._is_off(joint, end) for joint, end in ends.items()]
        return all(answered)

    def close(self) -> None:
        """End the threads; that of a drive that never returned is left behind, to be told off yet."""
        for joint, thread in self._threads.items():
            thread.shutdown(wait=joint not in self._stuck)

    def _worst_modes(self) -> dict[str, Mode]:
        """What each drive may be in: what it was told, unless it reports position mode since."""
        modes = {joint: self._told.get(joint, Mode.UNKNOWN) for joint in self._joints}
        for joint in self._joints:
            report = self._seen(joint)
            if report is None or report.time_ns < self._answered_ns.get(joint, 0):
                continue
            if report.mode is Mode.POSITION:
                modes[joint] = Mode.POSITION
        return modes

    def _require(self, joint: str, reason: str) -> None:
        if reason:
            self._record(Fault(self._clock.now_ns(), joint, "interlock", f"refused: {reason}"))
            raise Interlocked(joint, f"a command was refused: {reason}")

    def _insist(self, joint: str, command: Callable[[JointDrive], None]) -> None:
        self._wait(self._threads[joint].submit(self._give, joint, command))

    def _wait(self, answer: Future[_T]) -> _T:
        while not wait((answer,), WATCH_S).done:
            self._meanwhile()
        return answer.result()

    def _give(
        self, joint: str, command: Callable[[JointDrive], None], *, last: bool = False
    ) -> None:
        """Give a command, again if it is not answered; raises DriverError."""
        for attempt in range(1, ATTEMPTS + 1):
            if self._ending.is_set() and not last:
                return
            try:
                command(self._joints[joint])
                return
            except DeviceSilent as error:
                text = f"attempt {attempt} of {ATTEMPTS}: {error}"
                self._record(Fault(self._clock.now_ns(), joint, "no-answer", text))
                if attempt == ATTEMPTS:
                    raise

    def _switch_off(self, joint: str) -> None:
        self._give(joint, lambda drive: drive.set_mode(Mode.OFF), last=True)

    def _is_off(self, joint: str, end: Future[None]) -> bool:
        if not end.done():
            self._stuck.add(joint)
            why = f"it has not returned for {LONGEST_OFF_S:g} s"
        elif (error := end.exception()) is not None:
            why = f"{type(error).__name__}: {error}"
        else:
            self._told[joint] = Mode.OFF
            return True
        text = f"the drive of {joint} could not be switched off, its watchdog must do it: {why}"
        self._record(Fault(self._clock.now_ns(), joint, "not-safe", text))
        return False
