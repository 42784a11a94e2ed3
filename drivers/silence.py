"""Whether who should be heard has fallen silent, while somebody listened. Pure.

Time in which the host was held up does not count as silence: nobody listened, and what was sent
meanwhile still waits to be read. Nor does it count for nothing, so that on a host that is always
slow silence is noticed late, and noticed.
"""

from __future__ import annotations

from drivers.schedule import SECOND

STEP_NS = SECOND // 5
"""Most that the time between two looks counts; half of the timeout where that is shorter."""


class SilenceWatch:
    """Follows one sender.

    Args:
        timeout_ns: time without a word after which it is called silent, None where it may be.

    Attributes:
        timeout_ns: that time.
        silent: whether it is.
    """

    def __init__(self, timeout_ns: int | None) -> None:
        self.timeout_ns = timeout_ns
        self.silent = False
        self._looked_ns: int | None = None
        self._listened_ns = 0

    @property
    def expects(self) -> bool:
        """Whether something should be heard."""
        return self._looked_ns is not None

    def begin(self, now_ns: int) -> None:
        """From now on something should be heard."""
        self._looked_ns, self._listened_ns = now_ns, 0

    def end(self) -> None:
        """Nothing need be heard any more, or it cannot be for another reason."""
        self._looked_ns = None

    def hear(self, now_ns: int) -> bool:
        """Something was heard; whether that ends a silence."""
        if self._looked_ns is None:
            return False
        if now_ns > self._looked_ns:
            self._looked_ns = now_ns
        self._listened_ns = 0
        ended, self.silent = self.silent, False
        return ended

    def falls_silent(self, now_ns: int) -> bool:
        """Whether it is silent from now on; to be asked regularly, at each look for something to hear."""
        if self._looked_ns is None or self.timeout_ns is None:
            return False
        passed_ns = max(now_ns - self._looked_ns, 0)
        self._listened_ns += min(passed_ns, STEP_NS, self.timeout_ns // 2)
        self._looked_ns = now_ns
        if self.silent or self._listened_ns <= self.timeout_ns:
            return False
        self.silent = True
        return True
