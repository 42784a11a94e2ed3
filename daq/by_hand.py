"""A by-hand plan: the operator moves the mechanism, and standstill is found by itself.

A dwell is recorded when every channel stood still for the plan's settling and dwell times; it
is the later part. The first window that passes for still may hold the last of the motion,
hidden in the noise, and that must not get into the dwell. The next one
is awaited elsewhere: the readings have to differ from those of the last by more than noise.
"""

from __future__ import annotations

from daq.clock import SECOND
from daq.progress import Phase
from daq.standstill import Window, apart
from daq.states import Step
from daq.supervision import Supervision
from recordings.events import Dwell
from recordings.rig import Plan


class ByHandPlan:
    """Follows an operator through as many stops as the plan asks for.

    Args:
        plan: a plan in mode "by-hand".
        stops: how many dwells to record.
        supervision: the running session.
    """

    def __init__(self, plan: Plan, stops: int, supervision: Supervision) -> None:
        self._stops = stops
        self._session = supervision
        self._dwell_ns = round(plan.dwell * SECOND)
        self._settle_ns = round(plan.settle * SECOND)

    def run(self) -> None:
        """Record dwells until there are as many as the plan has stops.

        Raises:
            StopRequested: the operator asked to stop, or the longest duration is reached.
            SessionFailed: a link or the file failed.
        """
        before: dict[str, Window] | None = None
        self._session.step(Step.RECORD, "the operator moves")
        for number in range(1, self._stops + 1):
            begin_ns, end_ns, before = self._standstill(number, before)
            dwell = Dwell(self._session.now_ns(), begin_ns, end_ns, pose=number - 1, visit=0)
            self._session.record(dwell)

    def _standstill(
        self, number: int, before: dict[str, Window] | None
    ) -> tuple[int, int, dict[str, Window]]:
        """Wait for a standstill elsewhere than ``before``; its begin, end and samples."""
        first_ns = self._session.now_ns()
        while True:
            end_ns = self._session.tick()
            begin_ns = end_ns - self._dwell_ns
            rest_ns = begin_ns - self._settle_ns
            still = rest_ns >= first_ns and self._session.still(rest_ns, end_ns)
            samples = self._session.windows(begin_ns) if still or before is not None else {}
            elsewhere = before is None or apart(before, samples, self._session.noise)
            if still and elsewhere:
                return begin_ns, end_ns, samples
            hint = "hold still" if elsewhere else "move to a new pose"
            self._session.enter(Phase.WAITING, number, hint)
