"""A driven plan: the drives of the plan carry the mechanism from stop to stop.

Modes first: every drive is switched off (which acknowledges an old fault), then the joints
that the plan does not drive are set free, and only then its own joints hold position, one
after the other: at no moment are more joints in position mode than the plan drives.

Targets move along a straight line in small steps, the fastest drive at the plan's speed, so
that the free joints can follow and the closed loop stays closed. Standstill is not assumed
from a target that was sent but seen in the channels.
"""

from __future__ import annotations

from collections.abc import Sequence

from daq.clock import SECOND
from daq.drives import Drives
from daq.errors import SessionFailed
from daq.options import CaptureOptions
from daq.progress import Phase
from daq.scale import Scale, scale_of
from daq.standstill import FEWEST
from daq.states import Step
from daq.supervision import TICK_S, Supervision
from recordings.events import Dwell, Fault, Mode
from recordings.rig import Plan, Rig, Visit

TARGET_S = 0.1
"""Time between two targets of a move [s]; drives have profiles of their own in between."""

ARRIVED = 0.02
"""How far a drive joint may stand from its target to have arrived [rad or m].

A plan only has to go near its poses, since readings say where it went; this catches a joint
that did not go there at all.
"""


class DrivenPlan:
    """Executes one driven plan.

    Args:
        rig: the rig.
        plan: a plan in mode "driven".
        stops: its visits, in order.
        drives: the joint drives.
        supervision: the running session.
        options: timeouts.
    """

    def __init__(
        self,
        rig: Rig,
        plan: Plan,
        stops: Sequence[Visit],
        drives: Drives,
        supervision: Supervision,
        options: CaptureOptions,
    ) -> None:
        self._plan = plan
        self._stops = stops
        self._drives = drives
        self._session = supervision
        self._options = options
        self._scales = {joint: scale_of(rig, joint) for joint in plan.drives}
        self._targets: dict[str, float] = {}
        fewest_ns = round(2 * FEWEST / plan.sample * SECOND)
        self._settle_ns = max(round(plan.settle * SECOND), fewest_ns)
        self._dwell_ns = round(plan.dwell * SECOND)

    def run(self) -> None:
        """Visit every stop of the plan.

        Raises:
            StopRequested: the operator asked to stop.
            SessionFailed: a link, the file or a drive failed, or too many stops in a row were
                skipped.
            DriverError: a drive did not take a command.
        """
        self._session.enter(Phase.HOLDING, 0, "the drives take hold")
        self._take_hold()
        skipped = 0
        for number, visit in enumerate(self._stops, start=1):
            self._move(number, visit)
            trouble = self._stay(number, visit)
            if trouble is None:
                skipped = 0
                continue
            skipped += 1
            text = f"pose {visit.pose}, visit {visit.visit} was skipped: {trouble}"
            self._session.record(Fault(self._session.now_ns(), "plan", "skipped", text))
            if skipped >= self._options.skipped_stops:
                raise SessionFailed(
                    "plan", f"{skipped} stops in a row were skipped; the last: {trouble}"
                )

    def _take_hold(self) -> None:
        cause = "before the plan"
        others = [joint for joint in self._drives.joints if joint not in self._plan.drives]
        for joint in self._drives.joints:
            self._drives.set_mode(joint, Mode.OFF, cause)
            self._session.tick()
        for joint in others:
            self._drives.set_mode(joint, Mode.FREE, cause)
            self._session.tick()
        for joint in others:
            self._await_mode(joint, Mode.FREE)
        for joint in self._plan.drives:
            self._drives.set_mode(joint, Mode.POSITION, "hold for the plan")
            self._await_mode(joint, Mode.POSITION)
            self._targets[joint] = self._reading(self._scales[joint])
            self._drives.hold_at(joint, self._targets[joint])
        expected = dict.fromkeys(others, Mode.FREE) | dict.fromkeys(
            self._plan.drives, Mode.POSITION
        )
        self._session.watch_drives(expected)

    def _await_mode(self, joint: str, mode: Mode) -> None:
        begin_ns = self._session.now_ns()
        while (report := self._drives.report(joint)).mode is not mode:
            if self._session.tick() - begin_ns > self._options.mode_timeout_s * SECOND:
                raise SessionFailed(
                    joint,
                    f"the drive of {joint} was told {mode.name} and still reports "
                    f"{report.mode.name} after {self._options.mode_timeout_s:g} s (status word "
                    f"0x{report.status:04X}, error code 0x{report.error_code:04X})",
                )

    def _move(self, number: int, visit: Visit) -> None:
        """Ramp the targets to those of ``visit``."""
        self._session.enter(Phase.MOVING, number, f"moving to pose {visit.pose}")
        cause = f"to pose {visit.pose}, visit {visit.visit}"
        self._session.step(Step.MOVE, cause)
        begin = dict(self._targets)
        end = dict(zip(self._plan.drives, visit.targets, strict=True))
        seconds = max(abs(end[joint] - begin[joint]) for joint in end) / self._plan.move
        done = 0.0
        before_ns = self._session.now_ns()
        while done < 1.0:
            while (now_ns := self._session.tick()) - before_ns < TARGET_S * SECOND:
                pass
            # A target that is late, because a bus or a drive was slow, must not become a jump.
            step_s = min((now_ns - before_ns) / SECOND, 2.0 * TARGET_S)
            before_ns = now_ns
            if self._session.blind():
                # Where a joint cannot be seen, nothing is led on; the guard says for how long.
                continue
            done = min(1.0, done + step_s / seconds) if seconds > 0.0 else 1.0
            for joint, target in end.items():
                self._targets[joint] = begin[joint] + done * (target - begin[joint])
                raw = self._scales[joint].counts(self._targets[joint])
                self._drives.move_to(joint, raw, cause)
        self._session.step(Step.STAND, f"at pose {visit.pose}, visit {visit.visit}")

    def _stay(self, number: int, visit: Visit) -> str | None:
        """Wait for standstill and dwell there; say why not, if it never came."""
        arrived_ns = still_ns = self._session.now_ns()
        limit_ns = arrived_ns + round(self._options.still_timeout_s * SECOND)
        while True:
            self._session.enter(Phase.SETTLING, number, f"settling at pose {visit.pose}")
            begin_ns, trouble = self._settle(still_ns, limit_ns)
            if trouble is not None:
                return trouble
            self._session.enter(Phase.DWELLING, number, f"dwelling at pose {visit.pose}")
            self._session.step(Step.RECORD, f"pose {visit.pose}, visit {visit.visit} stands still")
            end_ns = begin_ns + self._dwell_ns
            while (now_ns := self._session.tick()) < end_ns + round(TICK_S * SECOND):
                pass
            moved = self._session.moving(begin_ns, end_ns)
            if not moved:
                self._session.record(Dwell(now_ns, begin_ns, end_ns, visit.pose, visit.visit))
                self._session.step(Step.STAND, "the dwell is recorded")
                return None
            self._session.step(Step.STAND, f"{', '.join(moved)} moved in the dwell")
            still_ns = now_ns

    def _settle(self, since_ns: int, limit_ns: int) -> tuple[int, str | None]:
        """Wait until all channels stood still for the settling time; its end, and trouble."""
        while True:
            now_ns = self._session.tick()
            begin_ns = now_ns - self._settle_ns
            if begin_ns < since_ns:
                continue
            restless = self._session.moving(begin_ns, now_ns)
            astray = self._astray()
            if not restless and not astray:
                return now_ns, None
            if now_ns > limit_ns:
                away = f"{', '.join(restless)} did not stand still" if restless else astray
                return now_ns, f"{away} within {self._options.still_timeout_s:g} s"

    def _astray(self) -> str:
        """Which drive joints stand away from their targets, in words; "" when none does."""
        away = [
            f"{joint} reads {self._reading(scale):.4g}, target {self._targets[joint]:.4g}"
            for joint, scale in self._scales.items()
            if abs(scale.away(self._reading(scale), self._targets[joint])) > ARRIVED
        ]
        return f"did not arrive: {'; '.join(away)} (rad or m)" if away else ""

    def _reading(self, scale: Scale) -> float:
        raw = self._session.live.latest(scale.channel)
        if raw is None:
            raise SessionFailed(scale.channel, f"channel {scale.channel} has delivered no reading")
        return scale.value(raw)
