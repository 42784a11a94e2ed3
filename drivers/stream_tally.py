"""Counts the readings of a channel that comes unasked, at a rate of its device's own. Pure.

Two things can say that readings are missing, and both are used:

- a sample counter: a step of n means that n - 1 were lost on the way. Exact, however often the
  counter wraps in the meantime, as long as a period is known or the pause is below half a turn.
- the period: a pause of n periods means that n - 1 are missing. Without a counter this is an
  estimate: readings that were only held up come in a burst, and are then taken off again.

Where neither is known, nothing can be said, and nothing is.
"""

from __future__ import annotations

from drivers.link import Losses


class StreamTally:
    """What came of one channel, and what should have.

    ``losses`` counts a pause that lasts as it grows; once the channel is back, its counter has
    the last word.

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

    def begin(self, now_ns: int) -> None:
        """From now on, readings are expected."""
        if self._last_ns is None:
            self._last_ns = now_ns

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
        if step is not None:
            if step > 1:
                self._stepped_over += step - 1
                self._gaps += not self._away
        elif self._last_ns is not None:
            self._judge_pause(time_ns - self._last_ns)
        self._last_ns = time_ns
        self._away = False

    def end(self, now_ns: int) -> None:
        """No readings are expected any more; what is missing by now stays missing."""
        self._charge(self._overdue(now_ns))
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

    def _judge_pause(self, pause_ns: int) -> None:
        if self._period_ns is None:
            return
        missing = round(pause_ns / self._period_ns) - 1
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
        if self._last_ns is None or self._period_ns is None:
            return 0
        return max((now_ns - self._last_ns) // self._period_ns - 1, 0)
