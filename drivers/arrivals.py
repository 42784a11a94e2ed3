"""What a device's own counter and clock say about the sample that has just arrived. Pure.

Counters and clocks of a few bits wrap; both are continued without end, with the host's time as
a guide to how often they did in a pause. A device that has restarted is told by its clock going
back, or, where it has none, by its counter. What cannot be told: a restart of a device whose
counter or clock happens to go on where it was, and of one whose counter has 8 bits or fewer
and that has no clock: so small a counter goes back at every wrap.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from drivers.counters import WrappingCounter
from recordings.events import Reading, ReadingFlag

FEWEST_BITS = 9
"""Of a counter whose going back means a restart."""


class Arrival(NamedTuple):
    """One sample; a tuple, because some thousands come in a second.

    Attributes:
        sequence: the sample counter modulo 2**32, None where there is none.
        device_time_ns: device time, continued over its wraps, None where there is none.
        step: of the counter since the sample before, None where that is not known.
        restarted: whether the device has started anew since the sample before.
    """

    sequence: int | None
    device_time_ns: int | None
    step: int | None
    restarted: bool

    @property
    def flags(self) -> ReadingFlag:
        """STALE where the device gave the sample before once more."""
        return ReadingFlag.STALE if self.step == 0 else ReadingFlag.NONE

    def reading(
        self, channel: str, time_ns: int, counts: int | None, flags: ReadingFlag = ReadingFlag.NONE
    ) -> Reading:
        """What ``channel`` measured in this sample, which arrived at ``time_ns``.

        Without ``counts`` the device gave no number: 0, flagged as an error of the device.
        ``flags`` are what the device says itself.
        """
        flags |= self.flags
        if counts is None:
            flags |= ReadingFlag.DEVICE_ERROR
        return Reading(
            channel=channel,
            time_ns=time_ns,
            raw=counts or 0,
            device_time_ns=self.device_time_ns,
            sequence=self.sequence,
            flags=flags,
        )


class Arrivals:
    """Follows the counter and the clock of one device.

    Args:
        counter_bits: width of its sample counter, None where it has none.
        clock_bits: width of its clock, None where it has none.
        tick_ns: one tick of its clock [ns].
        period_ns: time between two samples, None where it is not known.
        counter_only_rises: the counter may run so fast that a step of more than half a turn is
            no sign of a restart.
    """

    def __init__(
        self,
        counter_bits: int | None = None,
        clock_bits: int | None = None,
        tick_ns: int = 1,
        period_ns: int | None = None,
        *,
        counter_only_rises: bool = False,
    ) -> None:
        self._counter = None if counter_bits is None else WrappingCounter(counter_bits)
        self._counter_tells = (counter_bits or 0) >= FEWEST_BITS and not counter_only_rises
        self._modulus = 1 << (counter_bits or 0)
        self._clock = None if clock_bits is None else WrappingCounter(clock_bits)
        self._tick_ns = tick_ns
        self._period_ns = period_ns
        self._last_ns: int | None = None

    def take(self, time_ns: int, counter: int | None = None, ticks: int | None = None) -> Arrival:
        """A sample arrived at ``time_ns`` with these raw values."""
        since_ns = 0 if self._last_ns is None else time_ns - self._last_ns
        self._last_ns = time_ns
        restarted = False
        if self._clock is not None and ticks is not None:
            restarted = self._clock.advance(ticks, expected=round(since_ns / self._tick_ns)) < 0
        step = self._step(counter, since_ns)
        if step is not None and step < 0:
            if self._clock is None and self._counter_tells:
                restarted = True
            elif self._counter is not None:
                step += self._modulus
                self._counter.value = (self._counter.value or 0) + self._modulus
        if restarted:
            self._restart(counter, ticks)
            step = None
        sequence = None if self._counter is None else (self._counter.value or 0) % (1 << 32)
        device_ns = None if self._clock is None else (self._clock.value or 0) * self._tick_ns
        return Arrival(sequence, device_ns, step, restarted)

    def take_on(
        self, time_ns: int, counters: Sequence[int], ticks: Sequence[int] | None
    ) -> tuple[list[int], list[int] | None] | None:
        """More samples at the moment of the last one, if each is the next: sequences and device times.

        None, and nothing is taken, where ``time_ns`` is another moment, a counter does not go on by
        one each time, a clock goes back, or there is no counter to tell.
        """
        if time_ns != self._last_ns:
            return None
        if self._counter is None or self._counter.value is None or self._modulus < 4:
            return None
        value, count, modulus = self._counter.value, len(counters), self._modulus
        if counters != [each % modulus for each in range(value + 1, value + count + 1)]:
            return None
        times = None
        if self._clock is not None:
            readings = None if ticks is None else self._clock.go_on(ticks)
            if readings is None:
                return None
            times = [each * self._tick_ns for each in readings]
        self._counter.value = value + count
        return [each % (1 << 32) for each in range(value + 1, value + count + 1)], times

    def _step(self, counter: int | None, since_ns: int) -> int | None:
        if self._counter is None or counter is None:
            return None
        first = self._counter.value is None
        expected = 1 if self._period_ns is None else max(round(since_ns / self._period_ns), 0)
        step = self._counter.advance(counter, expected=expected)
        return None if first else step

    def _restart(self, counter: int | None, ticks: int | None) -> None:
        for wrapping, raw in ((self._counter, counter), (self._clock, ticks)):
            if wrapping is not None and raw is not None:
                wrapping.restart()
                wrapping.advance(raw)
