"""Follows the clocks of the devices on one link, and says once a second what is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from daq.clock import SECOND
from daq.device_clock import DeviceClock
from recordings.events import ClockSample, Event, Reading, ReadingFlag, RoundTrip

TOLD_S = 1.0
"""Time between two samples of a clock [s]."""

_DOUBTFUL = ReadingFlag.STALE | ReadingFlag.DEVICE_ERROR


class DeviceClocks:
    """The clocks behind one link. Used by the link's thread; `known` by any.

    Args:
        devices: device of each channel.
    """

    def __init__(self, devices: Mapping[str, str]) -> None:
        self._devices = dict(devices)
        self._speakers: dict[str, str] = {}
        self._clocks: dict[str, DeviceClock] = {}
        self._told_ns: dict[str, int] = {}
        self._latest: dict[str, ClockSample] = {}
        self._trips: dict[str, RoundTrip] = {}

    def follow(self, events: Sequence[Event]) -> list[ClockSample]:
        """Take note of ``events`` in order of arrival; what there is to say of clocks now."""
        said = []
        for event in events:
            if isinstance(event, Reading):
                if event.device_time_ns is None or event.flags & _DOUBTFUL:
                    continue
                sample = self._follow(event, event.device_time_ns)
                if sample is not None:
                    said.append(sample)
            elif isinstance(event, RoundTrip):
                self._take(event)
        return said

    @property
    def known(self) -> tuple[tuple[ClockSample, ...], tuple[RoundTrip, ...]]:
        """The latest of each clock, and of each device its shortest and longest round trip."""
        return tuple(self._latest.values()), tuple(self._trips.values())

    def _follow(self, reading: Reading, device_time_ns: int) -> ClockSample | None:
        device = self._devices[reading.channel]
        # All channels of a device have its one clock; the first one speaks for it.
        if self._speakers.setdefault(device, reading.channel) != reading.channel:
            return None
        clock = self._clocks.get(device)
        if clock is None:
            clock = self._clocks[device] = DeviceClock()
        if not clock.add(device_time_ns, reading.time_ns):
            return None
        if reading.time_ns - self._told_ns.get(device, 0) < TOLD_S * SECOND:
            return None
        found = clock.estimate()
        if found is None:
            return None
        self._told_ns[device] = reading.time_ns
        sample = ClockSample(
            source=device,
            time_ns=reading.time_ns,
            device_time_ns=found.device_time_ns,
            offset_ns=found.offset_ns,
            uncertainty_ns=round(found.uncertainty_ns),
            drift_ppb=round(1e9 * found.drift),
            drift_uncertainty_ppb=round(1e9 * found.drift_uncertainty),
        )
        self._latest[device] = sample
        return sample

    def _take(self, trip: RoundTrip) -> None:
        before = self._trips.get(trip.source, trip)
        self._trips[trip.source] = RoundTrip(
            trip.source,
            trip.time_ns,
            min(before.shortest_ns, trip.shortest_ns),
            max(before.longest_ns, trip.longest_ns),
        )
