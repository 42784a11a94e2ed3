"""Counts the readings of one channel, so that each one asked for is accounted for. Pure."""

from __future__ import annotations

from drivers.link import Losses


class Tally:
    """What was asked of a channel, what came, and where the rest went.

    A reading is under way from `ask` until it comes or the next `ask`; until then it counts
    neither as expected nor as lost. A reading that comes later still is taken off the losses
    again.
    """

    def __init__(self) -> None:
        self._asked = 0
        self._received = 0
        self._stepped_over = 0
        self._unasked = 0
        self._gaps = 0
        self._under_way = False

    @property
    def under_way(self) -> bool:
        """Whether the last reading asked for may still come."""
        return self._under_way and self._asked > self._received

    def ask(self, times: int = 1) -> None:
        """A reading was asked for; with ``times`` above 1, that many, of which the last may come."""
        self._asked += times
        self._under_way = True

    def receive(self, missed: int = 0) -> None:
        """A reading came; its sample counter says that ``missed`` before it were lost on the way."""
        self._received += 1
        self._asked = max(self._asked, self._received)
        self._under_way = False
        if missed > 0:
            self._stepped_over += missed
            self._gaps += 1

    def receive_unasked(self) -> None:
        """A reading came that belongs to no request, such as a repeated one."""
        self._asked += 1
        self._received += 1

    def give_up(self) -> None:
        """Nothing is under way any more."""
        self._under_way = False

    def begin_gap(self) -> None:
        """The link is interrupted: a reading under way is lost with it."""
        if self.under_way:
            self._asked -= 1
            self._unasked += 1
        self._under_way = False
        self._gaps += 1

    def lose(self, readings: int) -> None:
        """``readings`` were due in a gap and could not be asked for."""
        self._unasked += readings

    def skip(self, readings: int) -> None:
        """``readings`` were due while the host was late: a gap of a working link."""
        self._unasked += readings
        self._gaps += 1

    def losses(self) -> Losses:
        """The balance so far."""
        missing = self._asked - self._received - self.under_way
        stepped_over = min(self._stepped_over, missing)
        return Losses(
            expected=self._received + missing + self._unasked,
            dropped_by_device=missing - stepped_over,
            lost_in_gaps=stepped_over + self._unasked,
            gaps=self._gaps,
        )
