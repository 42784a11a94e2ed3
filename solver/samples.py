"""From a recording to averaged poses: the mean counts of every dwell, and how well each is known.

The noise of a channel is pooled over all dwells. Neighbouring samples are not independent:
the variance of a mean of n samples is s^2 tau / n, with tau the integrated autocorrelation
time. Where a channel is quieter than half a count, averaging does not beat quantisation,
and its variance of 1/12 count^2 is added. A dwell whose first and second half differ by
more than noise allows is rejected: the mechanism still moved. Where the dwells are too short
to show the noise (a table with one reading a pose), the noise that the rig states is believed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recordings.events import ReadingFlag
from recordings.reader import Recording
from recordings.rig import Channel, Rig, SerialMechanism
from solver.approach import approaches
from solver.dwells import EDGE_S, Track, Window, standstills, without_edges
from solver.errors import NotEnoughData
from solver.mechanism.circumstances import Circumstances

Array = NDArray[np.float64]

NO_MEASUREMENT = ReadingFlag.STALE | ReadingFlag.DEVICE_ERROR
"""Flags of readings that say nothing about where a joint is now."""

_STILL_MOVING = 5.0  # standard errors between the halves of a dwell
_FEWEST_SAMPLES = 4  # in a dwell, of every channel
_DITHER = 0.5  # counts: below this noise, averaging does not remove quantisation
_LONGEST_LAG = 50
_REFINED = 4  # rounds in which the autocorrelation time and what the line takes from it settle
_MOST_REMOVED = 0.2


@dataclass(frozen=True, slots=True)
class Rejected:
    """A dwell that was not used, and why."""

    window: Window
    reason: str


@dataclass(frozen=True)
class PoseTable:
    """Averaged readings of P dwells on C channels.

    Attributes:
        channels: names, in rig order.
        counts: (P, C) mean counts.
        sigma: (P, C) standard deviation of the means [counts].
        samples: (P, C) number of samples averaged.
        effective: (P, C) number of independent samples they are worth.
        noise: (C,) standard deviation of one sample [counts], pooled over dwells.
        correlation: (C,) integrated autocorrelation time [samples], 1 for white noise.
        windows: the P dwells.
        rejected: dwells left out.
        start_ns: when the session began, on the clock of the windows.
        approach: (P, C) from which side each channel's counts came to rest (`solver.approach`), or None.
        rate: (P, C) speed of each channel's value [rad/s or m/s]; None where every row is a dwell.
        sessions_ns: when each session began, where there are several; empty for one.
    """

    channels: tuple[str, ...]
    counts: Array
    sigma: Array
    samples: NDArray[np.int64]
    effective: Array
    noise: Array
    correlation: Array
    windows: tuple[Window, ...]
    rejected: tuple[Rejected, ...]
    start_ns: int = 0
    approach: Array | None = None
    rate: Array | None = None
    sessions_ns: tuple[int, ...] = ()

    def circumstances(self, rig: Rig) -> Circumstances:
        """Under what the poses were read, loads left open.

        Raises:
            NotEnoughData: ``rig`` has several fixtures, and a dwell says none of them.
        """
        names = rig.mechanism.fixture_names if isinstance(rig.mechanism, SerialMechanism) else ()
        rising = np.sign([channel.gain.nominal for channel in rig.channels])
        middle = np.array([0.5 * (w.start_ns + w.end_ns) for w in self.windows])
        return Circumstances(
            fixture=self._fixture(names),
            time_s=(middle - self.start_ns) * 1e-9,
            approach=None if self.approach is None else self.approach * rising,
            rate=np.zeros(self.counts.shape) if self.rate is None else self.rate,
            noise=np.tile(self.noise, (len(self.counts), 1)),
            begun_s=self._begun(middle),
        )

    def _begun(self, middle_ns: Array) -> Array | None:
        """(P,) when the session of each pose began [s]; None where there is but one."""
        if not self.sessions_ns:
            return None
        starts = np.array(self.sessions_ns)
        own = np.maximum(np.searchsorted(starts, middle_ns, side="right") - 1, 0)
        return np.asarray((starts[own] - self.start_ns) * 1e-9)

    def _fixture(self, names: Sequence[str]) -> NDArray[np.intp] | None:
        """(P,) which of the fixtures ``names`` held each pose; None where the rig has one at most.

        Raises:
            NotEnoughData: a dwell says no fixture, or one that the rig does not have.
        """
        if len(names) < 2:
            return None
        for window in self.windows:
            if window.fixture not in names:
                said = "no fixture" if window.fixture is None else f"'{window.fixture}'"
                raise NotEnoughData(
                    f"the dwell of pose {window.pose} names {said}, expected one of: {', '.join(names)}"
                )
        return np.array([names.index(str(w.fixture)) for w in self.windows], dtype=np.intp)


def track(recording: Recording, channel: Channel) -> Track:
    """One channel of a recording as counts that do not wrap.

    Readings that their device calls stale (an old sample, sent again) or no measurement are left out.
    """
    readings = recording.readings.get(channel.name)
    if readings is None or len(readings.raw) == 0:
        present = ", ".join(sorted(recording.readings)) or "none"
        raise NotEnoughData(
            f"the recording has no readings of channel '{channel.name}'; it has: {present}. "
            "Record all channels of the rig, or take the channel out of it."
        )
    measured = (readings.flags & np.uint32(NO_MEASUREMENT)) == 0
    if not np.any(measured):
        raise NotEnoughData(
            f"all {len(measured)} readings of channel '{channel.name}' are flagged by their device as "
            "stale or in error; mend the device, or take the channel out of the rig"
        )
    time_ns, counts = readings.time_ns, readings.raw.astype(np.float64)
    if not np.all(measured):
        time_ns, counts = time_ns[measured], counts[measured]
    if np.any(time_ns[1:] < time_ns[:-1]):
        order = np.argsort(time_ns, kind="stable")
        time_ns, counts = time_ns[order], counts[order]
    if channel.modulus_counts is not None:
        # Between two sessions a joint may have gone anywhere: each is unwrapped by itself.
        later = np.searchsorted(time_ns, recording.session_starts_ns[1:])
        for part in np.split(counts, later):  # views, in which the counts are set
            if len(part):
                own = np.unwrap(part, period=channel.modulus_counts)
                turns = np.round((np.median(own) - channel.zero_count) / channel.modulus_counts)
                part[:] = own - turns * channel.modulus_counts
    return Track(time_ns, counts)


def average(recording: Recording, *, shortest_s: float | None = None) -> PoseTable:
    """Averaged poses of ``recording``.

    Args:
        recording: what was captured.
        shortest_s: shortest standstill that counts as a dwell when the recording has no dwell
            messages; by default 0.6 of the rig's planned dwell, or 0.3 s.

    Raises:
        NotEnoughData: a channel has no readings, or there is no dwell.
    """
    rig = recording.rig
    tracks = {channel.name: track(recording, channel) for channel in rig.channels}
    if recording.dwells:
        windows = tuple(
            Window(d.start_ns, d.end_ns, d.pose, d.visit, d.fixture) for d in recording.dwells
        )
    else:
        if shortest_s is None:
            shortest_s = 0.6 * rig.plan.dwell if rig.plan is not None else 0.3
        windows = without_edges(standstills(tracks, shortest_s=shortest_s), EDGE_S)
    if not windows:
        raise NotEnoughData(
            "the recording has no dwells: it carries no dwell messages, and the readings show no standstill "
            f"of {shortest_s or 0:.2g} s on all channels at once. Hold the mechanism still at every pose."
        )
    fullest = max(len(_inside(track, window)) for window in windows for track in tracks.values())
    if fullest < _FEWEST_SAMPLES:
        table = _believed(rig, tracks, windows, recording.session.start_ns)
    else:
        table = _table(tracks, windows, recording.session.start_ns)
    return replace(table, sessions_ns=recording.session_starts_ns)


def _believed(
    rig: Rig, tracks: Mapping[str, Track], windows: tuple[Window, ...], start_ns: int
) -> PoseTable:
    """Dwells of a few readings each, with the noise that the rig states."""
    noise = np.array([channel.noise for channel in rig.channels])
    silent = [channel.name for channel in rig.channels if not channel.noise > 0]
    if silent:
        raise NotEnoughData(
            f"no dwell has {_FEWEST_SAMPLES} readings of a channel, too few to measure its noise, and the rig "
            f"states none for {', '.join(silent)}: give noise_counts there (the standard deviation of one reading)"
        )
    pieces = [[_inside(tracks[name], window) for name in tracks] for window in windows]
    whole = [w for w, row in enumerate(pieces) if all(len(piece) for piece in row)]
    if not whole:
        raise NotEnoughData(
            f"none of the {len(windows)} dwells has a reading of every channel; check their times"
        )
    samples = np.array([[len(piece) for piece in pieces[w]] for w in whole], dtype=np.int64)
    return PoseTable(
        channels=tuple(tracks),
        counts=np.array([[piece.mean() for piece in pieces[w]] for w in whole]),
        sigma=noise / np.sqrt(samples),
        samples=samples,
        effective=samples.astype(np.float64),
        noise=noise,
        correlation=np.ones(len(noise)),
        windows=tuple(windows[w] for w in whole),
        rejected=tuple(
            Rejected(window, "a channel has no reading")
            for w, window in enumerate(windows)
            if w not in whole
        ),
        start_ns=start_ns,
    )


def _table(tracks: Mapping[str, Track], windows: tuple[Window, ...], start_ns: int) -> PoseTable:
    names = tuple(tracks)
    pieces = [[_inside(tracks[name], window) for name in names] for window in windows]
    rejected: list[Rejected] = []
    whole: list[int] = []
    for w, row in enumerate(pieces):
        few = [name for name, piece in zip(names, row, strict=True) if len(piece) < _FEWEST_SAMPLES]
        if few:
            rejected.append(
                Rejected(windows[w], f"fewer than {_FEWEST_SAMPLES} samples of {', '.join(few)}")
            )
        else:
            whole.append(w)
    if not whole:
        raise NotEnoughData(
            f"none of the {len(windows)} dwells has samples of every channel; check the channels' rates"
        )
    noise, correlation = _noise(pieces, whole, len(names))

    kept: list[int] = []
    for w in whole:
        moved = _moved(pieces[w], noise, correlation)
        worst = int(np.argmax(np.abs(moved)))
        if abs(moved[worst]) > _STILL_MOVING:
            halves = _halves(pieces[w][worst])
            rejected.append(
                Rejected(
                    windows[w],
                    f"still moving: {names[worst]} moved {halves:+.1f} counts between the halves of the dwell",
                )
            )
        else:
            kept.append(w)
    if not kept:
        raise NotEnoughData(
            f"the mechanism still moved in all {len(whole)} dwells; wait longer before each dwell"
        )
    samples = np.array([[len(piece) for piece in pieces[w]] for w in kept], dtype=np.int64)
    effective = np.maximum(samples / correlation, 1.0)
    quantisation = np.where(noise < _DITHER, 1.0 / 12.0, 0.0)
    return PoseTable(
        channels=names,
        counts=np.array([[piece.mean() for piece in pieces[w]] for w in kept]),
        sigma=np.sqrt(noise**2 / effective + quantisation),
        samples=samples,
        effective=effective,
        noise=noise,
        correlation=correlation,
        windows=tuple(windows[w] for w in kept),
        rejected=tuple(rejected),
        start_ns=start_ns,
        approach=approaches(tracks, windows, noise)[kept],
    )


def _inside(track: Track, window: Window) -> Array:
    first, last = np.searchsorted(track.time_ns, [window.start_ns, window.end_ns + 1])
    return track.counts[first:last]


def _noise(pieces: list[list[Array]], rows: list[int], channels: int) -> tuple[Array, Array]:
    """Pooled standard deviation (C,) and integrated autocorrelation time (C,)."""
    sigma, tau = np.zeros(channels), np.ones(channels)
    for c in range(channels):
        # About each dwell's own straight line, so that a steady creep is not taken for noise; the
        # median over dwells keeps a few that move otherwise from setting the noise of all.
        level = {w: _detrended(pieces[w][c]) for w in rows}
        freedom = np.array([len(level[w]) - 2 for w in rows])
        variances = np.array([float(level[w] @ level[w]) for w in rows]) / freedom
        usual = np.median(variances)
        likely = usual * (1.0 + 3.0 * np.sqrt(2.0 / freedom)) + 1e-12
        quiet = [w for w, v, most in zip(rows, variances, likely, strict=True) if v <= most]
        centred = [level[w] for w in quiet]
        freedoms = sum(len(x) - 2 for x in centred)
        sigma[c] = np.sqrt(sum(float(x @ x) for x in centred) / freedoms)
        tau[c] = _integrated_time(centred)
    return sigma, tau


def _detrended(piece: Array) -> Array:
    """Samples (S,) about their straight line."""
    ramp = np.arange(len(piece)) - 0.5 * (len(piece) - 1)
    centred = piece - piece.mean()
    level: Array = centred - ramp * ((ramp @ centred) / (ramp @ ramp))
    return level


def _integrated_time(centred: list[Array]) -> float:
    """1 + 2 sum of autocorrelations, up to the first that noise explains (Geyer's initial sequence, pooled)."""
    power = sum(float(x @ x) for x in centred)
    if power == 0.0:
        return 1.0
    total = sum(len(x) for x in centred)
    mean_length = total / len(centred)
    correlations = []
    for lag in range(1, min(_LONGEST_LAG, int(mean_length) - 1)):
        pairs = sum(float(x[:-lag] @ x[lag:]) for x in centred if len(x) > lag)
        count = sum(len(x) - lag for x in centred if len(x) > lag)
        correlations.append(pairs / power * total / max(count, 1))
    tau = 1.0
    for _ in range(_REFINED):
        # Removing each dwell's own line lowers every autocorrelation by about 2 tau / length.
        removed = min(2.0 * tau / mean_length, _MOST_REMOVED)
        tau = 1.0
        for correlation in correlations:
            if correlation + removed < 2.0 / np.sqrt(total):
                break
            tau += 2.0 * (correlation + removed)
    return tau


def _halves(piece: Array) -> float:
    middle = len(piece) // 2
    return float(piece[middle:].mean() - piece[:middle].mean())


def _moved(row: list[Array], noise: Array, correlation: Array) -> Array:
    """(C,) difference between the halves of a dwell, in standard errors."""
    out = np.zeros(len(row))
    for c, piece in enumerate(row):
        error = np.sqrt((noise[c] ** 2 + 1.0 / 12.0) * correlation[c] * 4.0 / len(piece))
        out[c] = _halves(piece) / error
    return out
