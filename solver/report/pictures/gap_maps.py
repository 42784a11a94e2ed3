"""Each channel against the rest of the loop: over its value, time, approach and load, and over the pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from solver.gap.channels import Disagreement, moved
from solver.gap.fit import Fit
from solver.report.notation import Unit, figures, fine_unit
from solver.report.pictures.canvas import (
    AFTER,
    BAND,
    BEFORE,
    BESIDE,
    INK,
    MUTED,
    RULE,
    Picture,
    canvas,
    picture,
)

Array = NDArray[np.float64]

_BINS = 9
_JITTER = 0.16
_FULL = 30.0  # points^2, area of the marker of the largest disagreement of a channel
_SIGNS = ((1.0, BEFORE, "measured more than predicted"), (-1.0, BESIDE, "less"))
_LEAST = 3.0  # standard errors that a full marker stands for at least
_ONE = (
    " This loop gives but one equation a pose, so that all its channels disagree by the same number of standard "
    "errors: which one is at fault shows in the pattern, not in the size."
)


@dataclass(frozen=True, slots=True)
class Course:
    """Something that may go with a disagreement: one column of the maps.

    Attributes:
        label: of the axis, unit included.
        along: (P, C) what it was at every pose, for every channel.
        sides: whether it is a side (-1, 0, 1) and no quantity.
        nowhere: what is said of a channel for which there is nothing.
    """

    label: str
    along: Array
    sides: bool = False
    nowhere: str = "not known"


def courses(fit: Fit, found: Disagreement) -> tuple[Course, ...]:
    """What the recording knows of each pose that a disagreement may go with."""
    at, poses, channels = fit.at, *found.values.shape
    unit = {"deg": Unit("deg", 1.0), "m": Unit("mm", 1e-3)}
    scaled = found.values / np.array([unit[name].to_si for name in found.units])
    scaled = np.where(moved(fit), scaled, np.nan)
    kinds = list(dict.fromkeys(unit[name].name for name in found.units))
    out = [Course(f"its own value [{' or '.join(kinds)}]", scaled, nowhere="stood still")]
    if at.time_s is not None and np.ptp(at.time_s) > 0:
        minutes = (at.time_s - at.time_s.min()) / 60.0
        out.append(Course("time [min]", np.tile(minutes[:, None], (1, channels))))
    if at.approach is not None and np.any(at.approach != 0):
        out.append(Course("came from", at.approach, sides=True))
    if at.torque is not None:
        places = fit.model.site.rig.mechanism.places
        load = np.full((poses, channels), np.nan)
        for c, channel in enumerate(fit.model.site.rig.channels):
            if channel.senses in places:
                load[:, c] = at.torque[:, places.index(channel.senses)]
        if np.nanmax(np.abs(load), initial=0.0) > 0:
            turning = {
                fit.model.site.rig.mechanism.dimension_of(place) == "angle" for place in places
            }
        unit_of_load = " or ".join(
            "Nm" if turns else "N" for turns in sorted(turning, reverse=True)
        )
        out.append(Course(f"load [{unit_of_load}]", load))
    return tuple(out)


def disagreements(fit: Fit, found: Disagreement, *, after: bool) -> Picture:
    """A row a channel, a column a `Course`: measured minus predicted from the rest of the loop.

    Args:
        fit: the model, for the circumstances.
        found: the disagreement with it.
        after: whether the model has what was found missing.
    """
    columns = courses(fit, found)
    rows = len(found.channels)
    height = 0.75 + 0.98 * rows
    colour = AFTER if after else BEFORE
    told = []
    with canvas(height, arranged=False) as figure:
        grid = figure.subplots(rows, len(columns), squeeze=False)
        figure.subplots_adjust(
            left=0.09,
            right=0.925,
            wspace=0.1,
            hspace=0.52,
            top=1 - 0.28 / height,
            bottom=0.45 / height,
        )
        for c, name in enumerate(found.channels):
            difference, error = found.difference[:, c], found.standard_error[:, c]
            z = difference / error
            checked = bool(np.isfinite(z).any())
            rms = _rms(difference)
            shown, factor = _shown(found.units[c], rms)
            for axes, column in zip(grid[c], columns, strict=True):
                if not checked:
                    _empty(axes, "not checked by\nthe rest of the loop")
                    axes.set_yticks([])
                    continue
                typical = float(np.nanmedian(error)) / factor
                axes.axhspan(-2 * typical, 2 * typical, color=BAND, linewidth=0)
                axes.axhline(0.0, color=RULE, linewidth=0.8)
                _points(axes, column, c, difference / factor, colour)
                reach = 1.15 * max(float(np.nanmax(np.abs(difference))) / factor, 3.0 * typical)
                axes.set_ylim(-reach, reach)
                axes.yaxis.set_major_locator(MaxNLocator(3))
                if axes is not grid[c][0]:
                    axes.tick_params(labelleft=False)
            grid[c][0].set_ylabel(f"{name}\n{shown.name}" if checked else name, color=INK)
            if checked:
                _errors_at_right(grid[c][-1], float(np.nanmedian(error)) / factor)
                grid[c][0].set_title(
                    f"RMS {figures(rms / factor)} {shown.name} = {figures(_rms(z))} SE",
                    fontsize=8,
                    fontweight="normal",
                    color=MUTED,
                    pad=2,
                )
                told.append(f"{name} {figures(_rms(z))}")
        for axes, column in zip(grid[-1], columns, strict=True):
            axes.set_xlabel(column.label)
        figure.align_xlabels(grid[-1])
        return picture(
            figure,
            name="disagreement-after" if after else "disagreement-before",
            alternative=(
                f"Disagreement of each channel with the rest of the loop {'with' if after else 'without'} what was "
                f"found missing, RMS in standard errors: {', '.join(told)}."
            ),
            caption=(
                ("With what was found. " if after else "The rig as described. ")
                + "Measured reading minus what all other readings of the same pose predict it to be; the scale at the "
                "right counts its standard errors, and the band is ±2 of them. The line is the mean of neighbouring "
                "poses. The channel at fault shows a pattern over something: a curve over its own value, a slope over "
                "time, a step between the sides. Its neighbours in the loop show a shadow of it over quantities that "
                "go along with it." + _ONE * (fit.redundancy == 1)
            ),
        )


def pose_maps(before: Fit, first: Disagreement, last: Disagreement | None) -> Picture:
    """A map a channel over the plane in which the poses spread most: sign and size of its disagreement.

    Args:
        before: the rig as described.
        first: the disagreement with it.
        last: the same with what was found; None where nothing was.
    """
    x, y, labels = _plane(before)
    shown = [first] if last is None else [first, last]
    channels = len(first.channels)
    height = 0.85 + 1.28 * len(shown)
    with canvas(height, arranged=False) as figure:
        grid = figure.subplots(len(shown), channels, squeeze=False, sharex=True, sharey=True)
        figure.subplots_adjust(
            left=0.075,
            right=0.995,
            wspace=0.08,
            hspace=0.25,
            top=1 - 0.52 / height,
            bottom=0.42 / height,
        )
        for row, found in zip(grid, shown, strict=True):
            for c, axes in enumerate(row):
                z = found.difference[:, c] / found.standard_error[:, c]
                if not np.isfinite(z).any():
                    _empty(axes, "not checked")
                    continue
                largest = max(float(np.nanmax(np.abs(z))), _LEAST)
                for sign, colour, _ in _SIGNS:
                    chosen = sign * z > 0
                    axes.scatter(
                        x[chosen],
                        y[chosen],
                        s=np.maximum(_FULL * np.abs(z[chosen]) / largest, 0.4),
                        color=colour,
                        linewidths=0,
                    )
                axes.margins(0.1)
                axes.xaxis.set_major_locator(MaxNLocator(2))
                axes.yaxis.set_major_locator(MaxNLocator(3))
                axes.set_title(
                    f"{found.channels[c]}, to {figures(largest, 2)} SE",
                    fontsize=8,
                    fontweight="normal",
                    pad=2,
                )
        for axes in grid[-1]:
            axes.set_xlabel(labels[0])
        marks = [
            Line2D([], [], marker="o", linestyle="", markersize=4.5, color=colour, label=label)
            for _, colour, label in _SIGNS
        ]
        figure.legend(handles=marks, loc="upper left", ncols=2, bbox_to_anchor=(0.06, 1.0))
        for axes, word in zip(grid[:, 0], ("before", "after"), strict=False):
            axes.set_ylabel(f"{word}\n{labels[1]}" if last is not None else labels[1])
        return picture(
            figure,
            name="pose-maps",
            alternative="Maps of each channel's disagreement over the pose.",
            caption=(
                f"The same over the pose: {labels[0]} and {labels[1]} of each. The area of a mark grows with the "
                "disagreement, up to the number of standard errors above each map. Marks of one colour together are a pattern; mixed, they are noise."
            ),
        )


def _plane(fit: Fit) -> tuple[Array, Array, tuple[str, str]]:
    """The two readings of the drives, or the two directions in which all readings spread most."""
    rig, values = fit.model.site.rig, fit.values
    names = [c.senses for c in rig.channels]
    drives = () if rig.plan is None else rig.plan.drives
    if len(drives) == 2 and all(d in names for d in drives):
        pair = [names.index(d) for d in drives]
        scale = [np.pi / 180.0 if rig.dimension_of(names[c]) == "angle" else 1e-3 for c in pair]
        unit = ["deg" if rig.dimension_of(names[c]) == "angle" else "mm" for c in pair]
        label = tuple(f"{rig.channels[c].name} [{u}]" for c, u in zip(pair, unit, strict=True))
        return values[:, pair[0]] / scale[0], values[:, pair[1]] / scale[1], (label[0], label[1])
    values = values[:, moved(fit)] if moved(fit).sum() > 1 else values
    spread = values.std(axis=0)
    scaled = (values - values.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    left, singular, right = np.linalg.svd(scaled, full_matrices=False)
    sign = np.sign(right[np.arange(len(right)), np.argmax(np.abs(right), axis=1)])
    along = left * singular * sign
    return along[:, 0], along[:, min(1, along.shape[1] - 1)], ("1st principal", "2nd principal")


def _points(axes: Axes, column: Course, c: int, values: Array, colour: str) -> None:
    x = column.along[:, c]
    seen = np.isfinite(values) & np.isfinite(x)
    if not np.any(x[seen] != 0.0):
        _empty(axes, "none" if seen.any() else column.nowhere)
        return
    if column.sides:
        # Spread by the golden ratio: even, and the same every time.
        spread = _JITTER * (2.0 * np.modf(np.arange(len(x)) * 0.6180339887)[0] - 1.0)
        axes.plot(
            (x + spread)[seen], values[seen], "o", color=colour, markersize=2.0, markeredgewidth=0
        )
        sides = [s for s in (-1.0, 0.0, 1.0) if np.any(seen & (x == s))]
        means = [float(values[seen & (x == s)].mean()) for s in sides]
        for side, mean in zip(sides, means, strict=True):
            axes.plot([side - 0.3, side + 0.3], [mean, mean], color=INK, linewidth=1.4)
        axes.set_xlim(-1.5, 1.5)
        axes.set_xticks([-1, 0, 1], ["above", "still" if 0.0 in sides else "", "below"])
        return
    axes.plot(x[seen], values[seen], "o", color=colour, markersize=2.0, markeredgewidth=0)
    axes.plot(*_course(x[seen], values[seen]), color=INK, linewidth=1.2)
    axes.margins(x=0.03)
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _course(x: Array, y: Array) -> tuple[Array, Array]:
    """Means of neighbours along ``x``, in groups of equal number."""
    order = np.argsort(x, kind="stable")
    groups = np.array_split(order, min(_BINS, max(len(x) // 4, 1)))
    return np.array([x[g].mean() for g in groups]), np.array([y[g].mean() for g in groups])


def _errors_at_right(axes: Axes, error: float) -> None:
    def in_errors(value: Any) -> Any:
        return value / error

    def in_unit(errors: Any) -> Any:
        return errors * error

    second = axes.secondary_yaxis("right", functions=(in_errors, in_unit))
    second.yaxis.set_major_locator(MaxNLocator(3))
    second.set_ylabel("SE")
    second.tick_params(length=2.5)


def _empty(axes: Axes, why: str) -> None:
    axes.text(
        0.5,
        0.5,
        why,
        transform=axes.transAxes,
        ha="center",
        va="center",
        fontsize=7.5,
        color=MUTED,
    )
    axes.set_xticks([])


def _shown(unit: str, rms: float) -> tuple[Unit, float]:
    """A readable unit for differences that are stored in ``unit``, and its factor."""
    if unit == "m":
        shown = fine_unit("length", rms)
        return shown, shown.to_si
    shown = fine_unit("angle", float(np.deg2rad(rms)))
    return shown, shown.to_si / (np.pi / 180.0)


def _rms(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else float("nan")
