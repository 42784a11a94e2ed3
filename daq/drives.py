"""The joint drives of a session: every command is recorded with its cause.

Owns the way back to safe mode, which goes on past any drive that does not answer. A drive
that does not answer in time is told again, since an answer can be late on a busy bus and
every command may be repeated without harm; each time is recorded as a fault.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from daq.clock import Clock
from drivers import DeviceSilent, DriverError, JointDrive
from recordings.events import Event, Fault, Mode, ModeCommand, ModeReport

ATTEMPTS = 3
"""How often a drive that does not answer is told a command."""


class Drives:
    """All joint drives of a rig.

    Args:
        joints: drive of each joint.
        clock: time of the session.
        record: takes every command, and every fault on the way to safe mode.
    """

    def __init__(
        self, joints: Mapping[str, JointDrive], clock: Clock, record: Callable[[Event], None]
    ) -> None:
        self._joints = dict(joints)
        self._clock = clock
        self._record = record
        self._in_position: set[str] = set()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that have a drive."""
        return tuple(self._joints)

    def set_mode(self, joint: str, mode: Mode, cause: str) -> None:
        """Command a mode; raises DriverError."""
        self._record(ModeCommand(joint, self._clock.now_ns(), mode, None, cause))
        if mode is Mode.POSITION:
            self._in_position.add(joint)
        self._insist(joint, lambda drive: drive.set_mode(mode))
        if mode is not Mode.POSITION:
            self._in_position.discard(joint)

    def move_to(self, joint: str, target_raw: int, cause: str) -> None:
        """Command a target of position mode, in counts of the sensing channel; raises DriverError."""
        now_ns = self._clock.now_ns()
        self._record(ModeCommand(joint, now_ns, Mode.POSITION, target_raw, cause))
        self._insist(joint, lambda drive: drive.move_to(target_raw))

    def report(self, joint: str) -> ModeReport:
        """What the drive says it is doing."""
        return self._joints[joint].report()

    def make_safe(self, cause: str) -> None:
        """Switch every drive off, those in position mode first; what fails is recorded as a fault."""
        for joint in sorted(self._joints, key=lambda name: name not in self._in_position):
            try:
                self.set_mode(joint, Mode.OFF, cause)
            except DriverError as error:
                text = f"the drive of {joint} could not be switched off: {error}"
                self._record(Fault(self._clock.now_ns(), joint, "not-safe", text))

    def _insist(self, joint: str, command: Callable[[JointDrive], None]) -> None:
        """Give a command, again if it is not answered; raises DriverError."""
        for attempt in range(1, ATTEMPTS + 1):
            try:
                command(self._joints[joint])
                return
            except DeviceSilent as error:
                text = f"attempt {attempt} of {ATTEMPTS}: {error}"
                self._record(Fault(self._clock.now_ns(), joint, "no-answer", text))
                if attempt == ATTEMPTS:
                    raise
