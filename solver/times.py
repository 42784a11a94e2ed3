"""When the samples of a channel were taken, on the clock of the host: what readings in motion need.

A recording stamps what arrives. Where it says more, the times of samples are corrected by it
(`recordings.timing` says why these bound the age of a sample):

- jitter: a device's own clock, or its sample counter, tells samples that waited from others.
  Device time with the offset that the session measured (``/clock``) is the arrival of a sample
  that did not wait; without that, a straight line through all arrivals is.
- skew: a sample was taken between a request and its answer (``/round_trip``). Half of the
  shortest round trip is taken off, a rectangular uncertainty stays.

Averages over dwells need none of this: where nothing moves, a few milliseconds change nothing.
In motion a joint that turns with 0.5 rad/s goes 1 mrad in 2 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.recording import Readings, Recording
from recordings.rig import Channel

Array = NDArray[np.float64]

_BLOCK = 50  # samples over which transport is averaged
_LONGEST_WAIT_S = 2.0  # of a sample, behind a clock that is known
_UNKNOWN = 4.0  # standard uncertainties of a clock by which a sample may seem to come too early


@dataclass(frozen=True, slots=True)
class Taken:
    """Samples of one channel, in order of arrival.

    Attributes:
        time_s: (S,) when they were taken, since the session began [s].
        uncertainty_s: standard uncertainty of a time [s], what all times share included.
    """

    time_s: Array
    uncertainty_s: float


def taken(recording: Recording, channel: Channel, start_ns: int) -> Taken:
    """When the samples of ``channel`` were taken; ``start_ns`` is when the session began."""
    readings = recording.readings[channel.name]
    order = np.argsort(readings.time_ns, kind="stable")
    host = np.asarray((readings.time_ns[order] - start_ns) * 1e-9, dtype=np.float64)
    unhurried = _by_known_clock(recording, channel, readings, order)
    if unhurried is None:
        arrived = _by_line(readings, order, host)
    else:
        arrived = Taken(host - unhurried.time_s, unhurried.uncertainty_s)
    trips = [trip for trip in recording.round_trips if trip.source == channel.device]
    if not trips:
        return arrived
    shortest_s = 1e-9 * min(trip.shortest_ns for trip in trips)
    # Without a clock, samples that waited cannot be told: their own round trips bound them.
    longest_s = 1e-9 * float(np.median([trip.longest_ns for trip in trips]))
    width_s = shortest_s if unhurried is not None else longest_s
    return Taken(
        arrived.time_s - 0.5 * shortest_s,
        float(np.hypot(arrived.uncertainty_s, width_s / np.sqrt(12.0))),
    )


def _by_known_clock(
    recording: Recording, channel: Channel, readings: Readings, order: NDArray[np.intp]
) -> Taken | None:
    """How long each sample waited [s], by the device's clock; None where that is not known of all."""
    known = [sample for sample in recording.clock if sample.source == channel.device]
    if readings.device_time_ns is None or not known or not len(order):
        return None
    host, device = readings.time_ns[order], readings.device_time_ns[order]
    times = np.array([sample.time_ns for sample in known])
    # The sample of the clock that is next in time, before the first one the first.
    nearest = np.minimum(np.searchsorted(times, host), len(known) - 1)
    since = device - np.array([sample.device_time_ns for sample in known])[nearest]
    drift = np.array([1e-9 * (sample.drift_ppb or 0) for sample in known])[nearest]
    offset = np.array([sample.offset_ns for sample in known])[nearest]
    waited = 1e-9 * ((host - device - offset).astype(np.float64) - drift * since)
    uncertainty = 1e-9 * float(np.median([sample.uncertainty_ns for sample in known]))
    if waited.min() < -_UNKNOWN * uncertainty or waited.max() > _LONGEST_WAIT_S:
        return None
    return Taken(waited, uncertainty)


def _by_line(readings: Readings, order: NDArray[np.intp], host: Array) -> Taken:
    """Arrivals without their jitter where the device counts time or samples, else as they are."""
    clock: Array | None = None
    if readings.device_time_ns is not None:
        clock = (readings.device_time_ns[order] - readings.device_time_ns[order][0]) * 1e-9
    elif readings.sequence is not None:
        steps = np.mod(np.diff(readings.sequence[order].astype(np.int64)), 2**32)
        clock = np.concatenate([[0.0], np.cumsum(steps)]).astype(np.float64)
    if clock is None or len(host) < 2 * _BLOCK or not np.ptp(clock):
        intervals = np.diff(host)
        return Taken(host, float(np.std(intervals)) if len(intervals) else 0.0)
    middle, scale = clock.mean(), np.ptp(clock)
    line = np.stack([np.ones(len(clock)), (clock - middle) / scale], axis=1)
    fitted = np.asarray(line @ np.linalg.lstsq(line, host, rcond=None)[0], dtype=np.float64)
    left = host - fitted
    blocks = left[: len(left) // _BLOCK * _BLOCK].reshape(-1, _BLOCK).mean(axis=1)
    return Taken(fitted, float(np.std(blocks)))
