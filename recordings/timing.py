"""When the readings of each device were taken, as far as a recording can tell: ages and skews. Pure.

A reading is stamped when it arrives. It was taken some time before: its age. Two things bound it:

- a request: a reading was taken between the request and its answer, so that its age is at most
  the round trip;
- a device clock whose offset from the host's is known (`recordings.events.ClockSample`): readings
  that had to wait can be told from those that did not, and device time + offset is the arrival
  of a reading that did not wait. What is left of the age is the shortest delay, and that is at
  most the shortest round trip.

Owns the bounds and what they mean. Estimating clocks is the business of `daq.device_clock`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from recordings.events import ClockSample, RoundTrip
from recordings.rig import Rig

COVERAGE = 2
"""Standard uncertainties of a clock that are allowed for: 95 %."""


@dataclass(frozen=True, slots=True)
class DeviceTiming:
    """What is known of the times of one device.

    Attributes:
        device: device of the rig.
        port: port that it is on.
        channels: channels that it delivers.
        clock: the latest that is known of its clock, or None where it has none.
        shortest_ns: its shortest round trip, or None where it is not asked.
        longest_ns: its longest round trip, or None.
    """

    device: str
    port: str
    channels: tuple[str, ...]
    clock: ClockSample | None
    shortest_ns: int | None
    longest_ns: int | None

    @property
    def oldest_ns(self) -> int | None:
        """Largest age of its readings [ns]; None where nothing bounds it.

        With a clock, the age against device time + offset; without, against arrival.
        """
        if self.clock is None:
            return self.longest_ns
        if self.shortest_ns is None:
            return None
        return self.shortest_ns + COVERAGE * self.clock.uncertainty_ns


def timings(
    rig: Rig, clock: Iterable[ClockSample], round_trips: Iterable[RoundTrip]
) -> tuple[DeviceTiming, ...]:
    """Timing of every device of ``rig`` that delivers a channel, in the order of the rig.

    Args:
        rig: the rig.
        clock: what was recorded of clocks, in order of time.
        round_trips: what was recorded of answers.
    """
    latest = {sample.source: sample for sample in clock}
    trips: dict[str, list[RoundTrip]] = {}
    for trip in round_trips:
        trips.setdefault(trip.source, []).append(trip)
    out = []
    for device in rig.devices:
        channels = tuple(c.name for c in rig.channels if c.device == device.name)
        if not channels:
            continue
        own = trips.get(device.name, [])
        out.append(
            DeviceTiming(
                device=device.name,
                port=device.port,
                channels=channels,
                clock=latest.get(device.name),
                shortest_ns=min((trip.shortest_ns for trip in own), default=None),
                longest_ns=max((trip.longest_ns for trip in own), default=None),
            )
        )
    return tuple(out)


def skew(first: DeviceTiming, second: DeviceTiming) -> tuple[int | None, int | None]:
    """By how much earlier readings of ``first`` were taken than those of ``second`` at the same time.

    "At the same time" by device time + offset where there is a clock, else by arrival. Lowest and
    highest difference [ns]; None where nothing bounds that side.
    """
    lowest, highest = second.oldest_ns, first.oldest_ns
    return (None if lowest is None else -lowest), highest


@dataclass(frozen=True, slots=True)
class PortSkew:
    """Between the readings of two ports, in the worst case of their devices; as `skew` gives it."""

    first: str
    second: str
    lowest_ns: int | None
    highest_ns: int | None


def port_skews(timed: Iterable[DeviceTiming]) -> tuple[PortSkew, ...]:
    """Skew of every two ports."""
    ports: dict[str, list[DeviceTiming]] = {}
    for each in timed:
        ports.setdefault(each.port, []).append(each)
    names = list(ports)
    out = []
    for number, first in enumerate(names):
        for second in names[number + 1 :]:
            lowest = _worst(ports[second])
            highest = _worst(ports[first])
            out.append(PortSkew(first, second, None if lowest is None else -lowest, highest))
    return tuple(out)


def _worst(timed: Iterable[DeviceTiming]) -> int | None:
    ages = [each.oldest_ns for each in timed]
    known = [age for age in ages if age is not None]
    return max(known) if known and len(known) == len(ages) else None
