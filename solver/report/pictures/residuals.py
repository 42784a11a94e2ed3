"""What is left of every reading: measured minus predicted, by channel and pose, before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from solver.report.notation import Unit, figures, fine_unit
from solver.report.pictures.canvas import (
    AFTER,
    BAND,
    BEFORE,
    INK,
    PAPER,
    RULE,
    Picture,
    canvas,
    picture,
)
from solver.solve import Solution

Array = NDArray[np.float64]


def residuals(solution: Solution, expected: Array) -> Picture:
    """A row a channel: residuals of all poses before and after calibration.

    Args:
        solution: the solve.
        expected: (P, C) whitened residuals that noise alone leaves.
    """
    table = solution.table
    poses, channels = table.counts.shape
    used = np.isin(np.arange(poses), solution.selection.poses)
    gains = _gains(solution)
    dimensions = [solution.rig.dimension_of(c.senses) for c in solution.rig.channels]
    before = np.where(solution.before.closed[:, None], solution.before.residual, np.nan)
    after = np.where(solution.after.closed[:, None], solution.after.residual, np.nan)
    reach = 1.08 * max(
        4.0, float(np.nanmax(np.abs(after), initial=0.0)), 2.0 * float(expected.max())
    )
    told = []
    height = 0.85 + 0.9 * channels
    with canvas(height, arranged=False) as figure:
        grid = figure.subplots(channels, 2, squeeze=False, sharex=True)
        figure.subplots_adjust(
            left=0.09,
            right=0.93,
            wspace=0.17,
            hspace=0.38,
            top=1 - 0.42 / height,
            bottom=0.4 / height,
        )
        for c, name in enumerate(table.channels):
            step = float(np.median(table.sigma[:, c])) * abs(gains[c])  # SI of one standard error
            raw = before[:, c] * table.sigma[:, c] * gains[c]
            coarse = fine_unit(dimensions[c], _rms(raw))
            fine = fine_unit(dimensions[c], step)
            left, right = grid[c]
            _points(left, raw / coarse.to_si, used, BEFORE)
            left.set_ylabel(f"{name}\n{coarse.name}", color=INK)
            _note(left, _rms(raw), coarse, _rms(before[:, c]))
            band = 2.0 * float(np.median(expected[:, c]))
            right.axhspan(-band, band, color=BAND, linewidth=0)
            _points(right, after[:, c], used, AFTER)
            right.set_ylim(-reach, reach)
            right.set_ylabel("SE")
            _note(right, _rms(after[:, c]) * step, fine, _rms(after[:, c]))
            _second_scale(right, step / fine.to_si, fine)
            told.append(
                f"{name} RMS {figures(_rms(before[:, c]))} standard errors before, {figures(_rms(after[:, c]))} after"
            )
        grid[0][0].set_title("Before, at nominal parameters (own scale each)", pad=13)
        grid[0][1].set_title("After calibration (common scale)", pad=13)
        for axes in grid[-1]:
            axes.set_xlabel("pose, in order of recording")
        return picture(
            figure,
            name="residuals",
            alternative=f"Residuals of {poses} poses: {'; '.join(told)}.",
            caption=(
                "Measured minus predicted reading of every pose, at the closed configuration that fits its readings best. "
                "Filled: poses used; open: the others, which the fit has not seen. "
                "SE: standard error of a dwell's mean. The band is ±2 of what sensor noise alone leaves; patterns or points far outside it are what the model lacks. "
                "Mind the scales: before and after differ."
            ),
        )


def _gains(solution: Solution) -> Array:
    """(C,) size of a count, SI."""
    value = dict(
        zip(
            (p.name for p in solution.estimate.space.table),
            solution.estimate.parameters,
            strict=True,
        )
    )
    return np.array([value[f"{name}.gain"] for name in solution.table.channels])


def _rms(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else float("nan")


def _points(axes: Axes, values: Array, used: NDArray[np.bool_], colour: str) -> None:
    number = np.arange(len(values))
    axes.axhline(0.0, color=RULE, linewidth=0.8)
    axes.plot(number[used], values[used], "o", color=colour, markersize=2.6, markeredgewidth=0)
    axes.plot(
        number[~used],
        values[~used],
        "o",
        color=colour,
        markersize=2.8,
        markerfacecolor=PAPER,
        markeredgewidth=0.8,
    )
    axes.margins(x=0.02, y=0.15)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))


def _note(axes: Axes, rms_si: float, unit: Unit, rms_errors: float) -> None:
    axes.text(
        1.0,
        1.0,
        f"RMS {figures(rms_si / unit.to_si)} {unit.name} = {figures(rms_errors)} SE",
        transform=axes.transAxes,
        ha="right",
        va="bottom",
        fontsize=8,
        color=INK,
    )


def _second_scale(axes: Axes, factor: float, unit: Unit) -> None:
    """The same scale in the channel's unit, at the right."""

    def in_unit(errors: Any) -> Any:
        return errors * factor

    def in_errors(value: Any) -> Any:
        return value / factor

    second = axes.secondary_yaxis("right", functions=(in_unit, in_errors))
    second.yaxis.set_major_locator(MaxNLocator(3))
    second.set_ylabel(unit.name)
    second.tick_params(length=2.5)
