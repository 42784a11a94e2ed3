"""A message that its sender repeats: whether it has stopped, and whether two send it. Pure.

How often a message comes is learned from the first second of it: the cycle time of a DBC file
is a wish. Two senders show as a message that comes more often than it did; an adapter that has
stalled and gives what it kept at once does not, because a pause makes the time after it void.
"""

from __future__ import annotations

from drivers.schedule import SECOND
from drivers.silence import SilenceWatch
from recordings.events import Fault
from recordings.faults import FaultKind

WINDOW_NS = SECOND // 2
VOID_NS = 2 * SECOND
PAUSE_NS = SECOND // 20
"""A pause that is long for any message worth counting."""

DOUBLED, SINGLE = 1.5, 1.25
"""Of the usual number in a window: above the first there are two senders, below the second one."""

HELD_UP = 1.5
"""Of a window, that a host may be late with it."""

FEWEST = 10
"""Messages in a window for their number to mean anything."""


class MessageWatch(SilenceWatch):
    """Follows one message.

    Args:
        timeout_ns: time without it after which it is called silent, None where it may be.

    Attributes:
        doubled: whether two send it.
    """

    def __init__(self, timeout_ns: int | None) -> None:
        super().__init__(timeout_ns)
        self.doubled = False
        self._heard_ns = 0
        self._usual: int | None = None
        self._window_ns = 0
        self._void_until_ns = 0
        self._count = 0

    def begin(self, now_ns: int) -> None:
        """From now on it is expected; its rate is learned anew."""
        super().begin(now_ns)
        self._usual = None
        self._heard_ns = self._window_ns = self._void_until_ns = now_ns
        self._count = 0

    def hear(self, now_ns: int) -> bool:
        """It came; whether that ends a silence."""
        if now_ns - self._heard_ns > PAUSE_NS:
            self._void_until_ns = now_ns + VOID_NS
        self._heard_ns = now_ns
        self._count += 1
        return super().hear(now_ns)

    def hear_on(self, count: int) -> None:
        """It came ``count`` times more at the moment when it was last heard."""
        self._count += count

    def doubles(self, now_ns: int) -> bool:
        """Whether `doubled` changes now; to be asked regularly."""
        if not self.expects or now_ns - self._window_ns < WINDOW_NS:
            return False
        if now_ns - self._window_ns > HELD_UP * WINDOW_NS:
            # Nobody has looked for long: what was sent meanwhile is still to be read.
            self._void_until_ns = now_ns + VOID_NS
        count = self._count * WINDOW_NS / (now_ns - self._window_ns)
        self._window_ns, self._count = now_ns, 0
        if now_ns < self._void_until_ns:
            return False
        if self._usual is None:
            self._usual = round(count)
            return False
        if self._usual < FEWEST:
            return False
        limit = SINGLE if self.doubled else DOUBLED
        changed = self.doubled != (count > limit * self._usual)
        self.doubled = self.doubled != changed
        return changed


def doubled_fault(now_ns: int, device: str, message: str, watch: MessageWatch) -> Fault:
    """What to report when `MessageWatch.doubles`."""
    if not watch.doubled:
        return Fault(now_ns, device, FaultKind.SINGLE, f"only one device sends {message} again")
    text = (
        f"two devices send {message}, which is {device}'s: give one of them other identifiers; "
        f"until then neither can be trusted"
    )
    return Fault(now_ns, device, FaultKind.DUPLICATED, text)


def drive_faults(now_ns: int, device: str, message: str, watch: MessageWatch) -> list[Fault]:
    """What to report of the status of a drive, regularly."""
    faults = []
    if watch.timeout_ns is not None and watch.falls_silent(now_ns):
        text = f"{device} has not sent {message} for {watch.timeout_ns / SECOND:g} s"
        faults.append(Fault(now_ns, device, FaultKind.SILENT, text))
    if watch.doubles(now_ns):
        faults.append(doubled_fault(now_ns, device, message, watch))
    return faults


def status_watch(period_ns: int | None) -> MessageWatch:
    """The watch of a status message; where its cycle is not known, it may be sent on change only."""
    return MessageWatch(None if period_ns is None else max(5 * period_ns, SECOND // 10))
