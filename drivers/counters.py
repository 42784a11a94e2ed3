"""Counters of a few bits that wrap, as devices send them, continued without end. Pure."""

from __future__ import annotations

from collections.abc import Sequence


class WrappingCounter:
    """Continues a counter modulo 2**bits.

    Attributes:
        value: the continued count, None before the first. It starts at the first raw count.
    """

    def __init__(self, bits: int) -> None:
        self._modulus = 1 << bits
        self.value: int | None = None

    def advance(self, raw: int, expected: int = 0) -> int:
        """Take the next raw count; return its step from the last one, 0 for the first.

        Of all steps that explain ``raw``, the one nearest to ``expected`` is taken: with a
        good guess, more than one turn of the counter may lie between two counts. A negative
        step is a counter that went back (a restart, or messages out of order).
        """
        if self.value is None:
            self.value = raw
            return 0
        half = self._modulus // 2
        surplus = (raw - self.value - expected + half) % self._modulus - half
        step = expected + surplus
        self.value += step
        return step

    def go_on(self, raws: Sequence[int]) -> list[int] | None:
        """Take raw counts of one moment: the continued ones. None, and none is taken, if it goes back."""
        if self.value is None:
            return None
        half, value, values = self._modulus // 2, self.value, []
        for raw in raws:
            step = (raw - value + half) % self._modulus - half
            if step < 0:
                return None
            value += step
            values.append(value)
        self.value = value
        return values

    def restart(self) -> None:
        """Forget the count: the device has started anew."""
        self.value = None
