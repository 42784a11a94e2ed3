"""Bench calibration of one sensor against known displacements: its straight line, and how straight it is.

The best straight line counts = zero + displacement / gain is fitted by least squares: the
displacements of a milling machine or a dividing head are exact beside the sensor. Noise is the
scatter within a station, where it was read several times; linearity is the largest distance of
a station's mean from the line, in % of full scale (the span of the line over the table; the
usual "best straight line" definition). Where the stations leave the line by more than noise
allows (F test at 1 %), standard errors grow by the root of that F ratio: then the gain depends
on which displacements were chosen.

Refuses tables that cannot show a line. Owns no file formats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f as f_distribution

from solver.errors import NotEnoughData

Array = NDArray[np.float64]

_SIGNIFICANT = 0.99


@dataclass(frozen=True, slots=True)
class Figure:
    """A number with its standard error."""

    value: float
    standard_error: float


@dataclass(frozen=True)
class BenchCalibration:
    """A sensor as the bench shows it.

    Attributes:
        gain: displacement per count [rad/count or m/count].
        zero: counts at displacement 0.
        linearity: largest deviation of a station from the best straight line [% of full scale].
        noise: standard deviation of one reading [counts].
        full_scale: span of the line over the table [counts].
        inflation: factor on standard errors because stations leave the line; 1 where noise explains all.
        stations: (S,) displacements [rad or m], ascending.
        deviation: (S,) mean counts of each station minus the line.
        readings: (S,) readings of each station.
        repeated: whether noise comes from repeated readings; else it is the scatter about the
            line, nonlinearity included.
    """

    gain: Figure
    zero: Figure
    linearity: Figure
    noise: Figure
    full_scale: float
    inflation: float
    stations: Array
    deviation: Array
    readings: NDArray[np.int64]
    repeated: bool


def bench_calibration(displacement: ArrayLike, counts: ArrayLike) -> BenchCalibration:
    """Calibrate a sensor from readings at known displacements.

    Args:
        displacement: (M,) [rad or m]; readings of one station share one value exactly.
        counts: (M,).

    Raises:
        NotEnoughData: fewer than three stations, numbers that are not finite, or counts that
            do not follow the displacement.
    """
    x, y = np.asarray(displacement, dtype=float), np.asarray(counts, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise NotEnoughData(
            f"{x.size} displacements for {y.size} counts, expected as many of one as of the other"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise NotEnoughData("the table holds numbers that are not finite; remove those rows")
    stations, station, readings = np.unique(x, return_inverse=True, return_counts=True)
    if len(stations) < 3:
        raise NotEnoughData(
            f"the table has {len(stations)} different displacements, expected at least 3: "
            "a line through two says nothing about its straightness"
        )
    middle = x.mean()
    centred = x - middle
    spread = float(centred @ centred)
    slope = float(centred @ y) / spread
    level = float(y.mean())
    residual = y - level - slope * centred
    means = np.bincount(station, weights=y) / readings
    deviation = means - level - slope * (stations - middle)

    within = y - means[station]
    repeats = len(y) - len(stations)
    if repeats > 0 and within @ within > 0:
        freedoms, variance = repeats, float(within @ within) / repeats
        off_line = float(readings @ deviation**2) / (len(stations) - 2)
        limit = float(f_distribution.ppf(_SIGNIFICANT, len(stations) - 2, repeats))
        ratio = off_line / variance
        inflation = float(np.sqrt(ratio)) if ratio > limit else 1.0
    else:
        freedoms = len(y) - 2
        variance, inflation = float(residual @ residual) / freedoms, 1.0
    sigma = float(np.sqrt(variance))
    full_scale = abs(slope) * float(stations[-1] - stations[0])
    if not full_scale > 3.0 * sigma:
        raise NotEnoughData(
            f"the counts follow the displacement by {full_scale:.3g} over the whole table, within "
            f"their own scatter of {sigma:.3g}; check the wiring, the column and the unit"
        )
    slope_error = inflation * sigma / np.sqrt(spread)
    zero = level - slope * middle
    zero_error = inflation * sigma * np.sqrt(1.0 / len(y) + middle**2 / spread)
    worst = int(np.argmax(np.abs(deviation)))
    leverage = 1.0 / len(y) + (stations[worst] - middle) ** 2 / spread
    worst_error = sigma * np.sqrt(max(1.0 / readings[worst] - leverage, 0.0))
    return BenchCalibration(
        gain=Figure(1.0 / slope, float(slope_error) / slope**2),
        zero=Figure(zero, float(zero_error)),
        linearity=Figure(
            100.0 * float(np.abs(deviation[worst])) / full_scale,
            100.0 * float(worst_error) / full_scale,
        ),
        noise=Figure(sigma, sigma / np.sqrt(2.0 * freedoms)),
        full_scale=full_scale,
        inflation=inflation,
        stations=stations,
        deviation=deviation,
        readings=readings,
        repeated=repeats > 0 and bool(within @ within > 0),
    )
