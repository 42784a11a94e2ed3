"""What a session knows of its rig right now, seen before anything is queued or written.

Control must not depend on the disk: the threads of the links show every event here first,
and the session judges standstill, modes and rates from it. Safe to use from any thread.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from daq.clock import SECOND
from daq.standstill import Window
from recordings.events import Event, Fault, ModeReport, Reading, ReadingFlag
from recordings.faults import ENDS
from recordings.rig import Channel

KEPT_FAULTS = 1000
"""Faults kept one by one; beyond these they are only counted."""


_UNUSABLE = ReadingFlag.STALE | ReadingFlag.DEVICE_ERROR


class LiveState:
    """Latest readings of each channel, latest mode of each joint, faults so far.

    Args:
        channels: channels of the rig.
        keep: how many samples of each channel to keep.
    """

    def __init__(self, channels: Iterable[Channel], keep: int) -> None:
        self._lock = threading.Lock()
        self._rings = {channel.name: _Ring(keep, channel.modulus_counts) for channel in channels}
        self._modes: dict[str, ModeReport] = {}
        self._faults: list[Fault] = []
        self._fault_counts: Counter[str] = Counter()

    def observe(self, events: Sequence[Event]) -> None:
        """Take note of ``events``, in the order of their arrival."""
        with self._lock:
            for event in events:
                match event:
                    case Reading():
                        self._rings[event.channel].add(event)
                    case ModeReport():
                        self._modes[event.joint] = event
                    case Fault():
                        self._fault_counts[event.source] += event.kind not in ENDS
                        if len(self._faults) < KEPT_FAULTS:
                            self._faults.append(event)

    def windows(self) -> Mapping[str, Window]:
        """Per channel, the samples still kept, oldest first."""
        with self._lock:
            return {name: ring.window() for name, ring in self._rings.items()}

    def latest(self, channel: str) -> int | None:
        """Raw count of the newest usable reading of ``channel``, or None before the first."""
        with self._lock:
            return self._rings[channel].latest

    def silent(self) -> tuple[str, ...]:
        """Channels of which no usable reading has come yet."""
        with self._lock:
            return tuple(name for name, ring in self._rings.items() if ring.latest is None)

    def newest(self, count: int) -> tuple[Mapping[str, Window], Mapping[str, int]]:
        """Per channel, its newest ``count`` samples, oldest first, and the raw count of the last one."""
        with self._lock:
            windows = {name: ring.window(count) for name, ring in self._rings.items()}
            latest = {n: ring.latest for n, ring in self._rings.items() if ring.latest is not None}
            return windows, latest

    def ages(self, now_ns: int) -> Mapping[str, int]:
        """Per channel, how long ago its newest usable reading came [ns]."""
        with self._lock:
            return {name: now_ns - ring.latest_ns for name, ring in self._rings.items()}

    def mode(self, joint: str) -> ModeReport | None:
        """Latest report of the drive of ``joint``, or None before the first."""
        with self._lock:
            return self._modes.get(joint)

    def rates(self, now_ns: int) -> Mapping[str, float]:
        """Per channel, readings in the last second [Hz]."""
        with self._lock:
            return {name: ring.rate(now_ns) for name, ring in self._rings.items()}

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults in the order of their arrival, at most `KEPT_FAULTS`."""
        with self._lock:
            return tuple(self._faults)

    @property
    def fault_count(self) -> int:
        """Number of all faults, those that are over included; their ends are not counted."""
        with self._lock:
            return self._fault_counts.total()


class _Ring:
    """The newest samples of one channel, unwrapped."""

    def __init__(self, keep: int, modulus: int | None) -> None:
        self._time_ns = np.zeros(keep, np.int64)
        self._counts = np.zeros(keep, np.int64)
        self._total = 0
        self._unwrapped = 0
        self._modulus = modulus
        self.latest: int | None = None
        self.latest_ns = 0

    def add(self, reading: Reading) -> None:
        if reading.flags is not ReadingFlag.NONE and reading.flags & _UNUSABLE:
            return
        step = reading.raw - (reading.raw if self.latest is None else self.latest)
        if self._modulus is not None:
            half = self._modulus // 2
            step = (step + half) % self._modulus - half
        self._unwrapped += step
        self.latest = reading.raw
        self.latest_ns = reading.time_ns
        at = self._total % len(self._counts)
        self._time_ns[at] = reading.time_ns
        self._counts[at] = self._unwrapped
        self._total += 1

    def window(self, count: int | None = None) -> Window:
        """The newest ``count`` samples, or all that are kept; oldest first."""
        keep = len(self._counts)
        have = min(self._total, keep)
        wanted = have if count is None else min(count, have)
        at = np.arange(self._total - wanted, self._total) % keep
        return Window(self._time_ns[at], self._counts[at])

    def rate(self, now_ns: int) -> float:
        window = self.window()
        return float(np.count_nonzero(window.time_ns > now_ns - SECOND))
