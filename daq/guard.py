"""The guard of a session: at every tick, whether it may go on, and only then a word to the drives.

Drives fall into their safe state by themselves when nobody vouches for them. That word comes
from here, from the thread that supervises, and is good for `VOUCHED_S`: when this thread hangs,
is suspended or dies, the links stop sending the heartbeat though their own threads live on.

Nothing is judged in a session without drives, or while none may be powered: then an outage
costs readings only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from daq.arming import Arming
from daq.clock import SECOND
from daq.drives import Drives
from daq.errors import ArmingExpired, Interlocked, SessionFailed
from daq.interlocks import Interlocks
from daq.live import LiveState
from daq.standstill import Window
from daq.states import SessionStates
from recordings.events import Fault
from recordings.rig import Plan, Rig

VOUCHED_S = 0.3
"""How long one word to the drives is good for [s]: some fifteen ticks."""

LONGEST_LAPSE_S = 1.0
"""Time between two ticks [s] after which the session has not been supervised, and ends."""

BLIND_S = 0.1
"""Time without a reading of a joint [s] after which drives are not led on, at fast sampling."""

SLOW = 5.0
"""Intervals between readings after which a channel that delivers slowly is silent."""


FEW = 16
"""Newest readings from which the rate of a slow channel is known."""


class Guard:
    """Watches over one session.

    Args:
        rig: the rig.
        plan: the plan being executed.
        states: state of the session.
        drives: its drives.
        interlocks: what may not be.
        arming: the operator's permission, or None where none is needed.
        live: what is seen.
        record: takes faults.
    """

    def __init__(
        self,
        *,
        rig: Rig,
        plan: Plan,
        states: SessionStates,
        drives: Drives,
        interlocks: Interlocks,
        arming: Arming | None,
        live: LiveState,
        record: Callable[[Fault], None],
    ) -> None:
        self._states = states
        self._drives = drives
        self._interlocks = interlocks
        self._arming = arming
        self._live = live
        self._record = record
        places = rig.mechanism.places
        self._joints = {c.name: c.senses for c in rig.channels if c.senses in places}
        self._silence_s = max(rig.interlocks.silence, SLOW / plan.sample)
        self._blind_s = max(BLIND_S, SLOW / plan.sample)
        self._keep = max(16, round(0.25 * plan.sample))
        self._looked_ns: int | None = None

    @property
    def arming(self) -> Arming | None:
        """The operator's permission, or None where none is needed."""
        return self._arming

    def look(self, now_ns: int) -> None:
        """Judge the session, and vouch for the drives.

        Raises:
            ArmingExpired: nobody renewed the arming.
            Interlocked: a joint is seen outside its limits.
            SessionFailed: this thread was held up, a drive does not answer, or a joint's channel
                is silent.
        """
        if not self._drives.joints or not self._states.allowed.vouched:
            self._looked_ns = None
            return
        lapse_s = 0.0 if self._looked_ns is None else (now_ns - self._looked_ns) / SECOND
        self._looked_ns = now_ns
        if lapse_s > LONGEST_LAPSE_S:
            raise SessionFailed(
                "supervision",
                f"the session was held up for {lapse_s:.1f} s and could not supervise the drives "
                f"(suspended, or the computer was busy); expected a look every {LONGEST_LAPSE_S:g} s",
            )
        if self._arming is not None and self._arming.left_s <= 0.0:
            raise ArmingExpired(self._arming.valid_s)
        if lost := self._drives.lost(now_ns):
            raise SessionFailed("drives", lost)
        if silent := self._silent(now_ns, self._silence_s):
            raise SessionFailed(
                silent[0],
                f"no reading of {', '.join(silent)} for {self._silence_s:g} s while drives are powered "
                "(silence_s of the rig's interlocks)",
            )
        windows, latest = self._live.newest(self._keep)
        for joint, text in self._interlocks.of_motion(windows, latest).items():
            self._record(Fault(now_ns, joint, "interlock", text))
            raise Interlocked(joint, text)
        self._drives.vouch(now_ns + round(VOUCHED_S * SECOND))

    def blind(self, now_ns: int) -> Sequence[str]:
        """Channels of joints that have been silent for too long to lead the drives on."""
        return self._silent(now_ns, self._blind_s)

    def _silent(self, now_ns: int, longest_s: float) -> Sequence[str]:
        ages = self._live.ages(now_ns)
        late = [name for name in self._joints if ages[name] > longest_s * SECOND]
        if not late:
            return late
        # A device may deliver at a rate of its own, slower than the plan's.
        windows, _ = self._live.newest(FEW)
        return [name for name in late if ages[name] > SLOW * _interval_ns(windows[name])]


def _interval_ns(window: Window) -> float:
    """Median time between readings [ns]; 0 where there are too few to tell."""
    return float(np.median(np.diff(window.time_ns))) if len(window.time_ns) > 1 else 0.0
