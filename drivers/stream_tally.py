"""Counts the readings of a channel that comes unasked, at a rate of its device's own. Pure.

Two things can say that readings are missing, and both are used:

- a sample counter: a step of n means that n - 1 were lost on the way. Exact, however often the
  counter wraps in the meantime, as long as a period is known or the pause is below half a turn.
  A step for which there was no time is doubtful: frames that were lost behind full buffers, while
  the host was held up, look so, and so does a damaged or another device's counter. It counts
  once the next reading goes on from there, and is no loss where the counter goes back.
- the period: a pause of n periods means that n - 1 are missing. Without a counter this is an
  estimate: readings that were only held up come in a burst, and are then taken off again.

Where neither is known, nothing can be said of a port that works: the device may send when it
likes. What an outage of the port costs is then estimated by the mean pause before it.
"""

from __future__ import annotations

from drivers.link import Losses
from drivers.schedule import SECOND

PERIODS_OF_PATIENCE = 5
SHORTEST_PATIENCE_NS = SECOND // 10
MEMORY = 64
"""Pauses over which the mean one is taken."""

FEWEST_PAUSES = 4

ROOM = 20.0
"""Readings by which a burst may run ahead of its time."""

HURRY = 1.25
"""How much faster than it says, or than it did, a device may be."""


class StreamTally:
    """What came of one channel, and what should have.

    ``losses`` counts a pause that lasts as it grows, once it is longer than a busy host explains
    (five periods, 0.1 s at least); once the channel is back, its counter has the last word.

    Args:
        period_ns: time between two readings, None where it is not known.
    """

    def __init__(self, period_ns: int | None) -> None:
        self._period_ns = period_ns
        self._received = 0
        self._stepped_over = 0
        self._missed = 0
        self._missed_away = 0
        self._owed = 0
        self._gaps = 0
        self._last_ns: int | None = None
        self._away = False
        self._fresh = False
        self._pauses = 0
        self._mean_ns = 0.0
        self._room = ROOM
        self._doubtful = 0
        self._anew = True

    def begin(self, now_ns: int) -> None:
        """From now on, readings are expected."""
        if self._last_ns is None:
            self._last_ns = now_ns
            self._fresh = True

    def interrupt(self) -> None:
        """The port has gone away."""
        if self._last_ns is not None and not self._away:
            self._away = True
            self._gaps += 1

    def receive(self, time_ns: int, step: int | None) -> None:
        """A reading came.

        Args:
            time_ns: when.
            step: of the sample counter since the reading before; 0 for the same sample again,
                None where there is no counter, or it tells nothing (the first reading, a restart).
        """
        self._received += 1
        room = self._room_until(time_ns)
        if step == 1 and not self._doubtful:
            self._anew = False
        elif step is not None:
            self._take_step(step, room)
        elif self._last_ns is not None:
            self._judge_pause(time_ns - self._last_ns)
        if step is None:
            self._doubtful, self._anew = 0, True
        if self._last_ns is not None and not (self._away or self._fresh):
            self._pauses += 1
            pause_ns = time_ns - self._last_ns
            self._mean_ns += (pause_ns - self._mean_ns) / min(self._pauses, MEMORY)
        self._last_ns = time_ns
        self._away = self._fresh = False

    @property
    def steady(self) -> bool:
        """Whether readings have come for a while, and nothing is in doubt: `receive_on` may be used."""
        known = self._period_ns is not None or self._mean_ns > 0.0
        return known and not self._doubtful and self._pauses >= MEMORY

    def receive_on(self, count: int) -> None:
        """What `receive` does ``count`` times at the moment of the last reading, with steps of 1."""
        self._received += count
        self._room = max(min(self._room, ROOM) - count, 0.0)
        self._anew = False
        self._mean_ns *= (1.0 - 1.0 / MEMORY) ** count

    def end(self, now_ns: int) -> None:
        """No readings are expected any more; what is missing by now stays missing."""
        self._charge(self._overdue(now_ns))
        self._step_over(self._doubtful)
        self._doubtful = 0
        self._last_ns = None
        self._away = False

    def losses(self, now_ns: int) -> Losses:
        """The balance at ``now_ns``."""
        overdue = self._overdue(now_ns)
        missed = self._missed + (0 if self._away else overdue)
        in_gaps = self._stepped_over + self._missed_away + (overdue if self._away else 0)
        return Losses(
            expected=self._received + missed + in_gaps,
            dropped_by_device=missed,
            lost_in_gaps=in_gaps,
            gaps=self._gaps,
        )

    def _take_step(self, step: int, room: int) -> None:
        """Count what the counter has stepped over, now or once it is sure."""
        self._step_over(self._doubtful)  # the counter has gone on from there
        self._doubtful = 0
        missing = step - 1
        if missing > room and not self._anew:
            self._doubtful = missing
        elif missing > 0:
            # Behind a counter that went back, another jump may be its way to where it was.
            missing = min(missing, room)
            self._step_over(missing)
            self._room -= missing
        self._anew = False

    def _step_over(self, missing: int) -> None:
        if missing > 0:
            self._stepped_over += missing
            self._gaps += not self._away

    def _room_until(self, time_ns: int) -> int:
        """How many readings more than this one the time can have held, as far as it is known."""
        period_ns: float | None = self._period_ns
        mean_ns = self._mean_ns
        if self._pauses >= FEWEST_PAUSES and mean_ns > 0.0:
            period_ns = mean_ns if period_ns is None or mean_ns < period_ns else period_ns
        if period_ns is None or self._last_ns is None:
            return 1 << 32
        room = self._room if self._room < ROOM else ROOM
        room += HURRY * (time_ns - self._last_ns) / max(period_ns, 1.0) - 1.0
        self._room = room if room > 0.0 else 0.0
        return int(self._room)

    def _period(self) -> float | None:
        """The period to judge a pause by now [ns], None where there is none."""
        if self._period_ns is None and self._away and self._pauses >= FEWEST_PAUSES:
            return self._mean_ns or None
        return self._period_ns

    def _judge_pause(self, pause_ns: int) -> None:
        period_ns = self._period()
        # A stream is joined anywhere: its first sample may be cut off, and come late for that.
        if period_ns is None or (self._fresh and pause_ns <= _patience_ns(period_ns)):
            return
        missing = round(pause_ns / period_ns) - 1
        if missing > 0:
            self._charge(missing)
        elif missing < 0 and self._owed:
            self._owed -= 1
            if self._missed:
                self._missed -= 1
            else:
                self._missed_away -= 1

    def _charge(self, missing: int) -> None:
        self._owed = missing
        if self._away:
            self._missed_away += missing
        else:
            self._missed += missing

    def _overdue(self, now_ns: int) -> int:
        """Whole periods that have passed without a reading, beyond the one that is under way."""
        period_ns = self._period()
        if self._last_ns is None or period_ns is None:
            return 0
        pause_ns = now_ns - self._last_ns
        return 0 if pause_ns <= _patience_ns(period_ns) else int(pause_ns // period_ns) - 1


def _patience_ns(period_ns: float) -> float:
    return max(PERIODS_OF_PATIENCE * period_ns, SHORTEST_PATIENCE_NS)
