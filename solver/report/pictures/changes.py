"""What the calibration changed: estimate minus nominal with intervals, and who else says what."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from solver.report.comparison import Compared
from solver.report.pictures.canvas import (
    AFTER,
    BAND,
    BESIDE,
    INK,
    MARKERS,
    PAPER,
    RULE,
    TRUTH,
    Picture,
    canvas,
    picture,
)

_LINEAR = 3.0  # standard errors up to which the scale is linear; beyond, it is logarithmic
_FARTHEST = 1e4  # standard errors; what lies beyond is drawn at the edge


def changes(rows: Sequence[Compared], method: str, beside: Sequence[str]) -> Picture:
    """Estimate minus nominal, a panel a unit; beside it the differences from the estimate.

    Args:
        rows: the identified parameters.
        method: name of the method that the estimate is by.
        beside: names of the other methods.
    """
    units = list(dict.fromkeys(row.unit.name for row in rows))
    groups = [[row for row in rows if row.unit.name == unit] for unit in units]
    true = any(row.truth is not None for row in rows)
    others = bool(beside) or true
    with canvas(0.62 + sum(0.52 + 0.23 * len(group) for group in groups)) as figure:
        grid = figure.subplots(
            len(groups),
            2 if others else 1,
            squeeze=False,
            sharey="row",
            height_ratios=[len(group) + 1.2 for group in groups],
        )
        reach = _reach(rows)
        for line, unit, group in zip(grid, units, groups, strict=True):
            _from_nominal(line[0], group, unit)
            if others:
                _from_estimate(line[1], group, reach)
        grid[0][0].set_title("Change from nominal")
        if others:
            grid[0][1].set_title("Difference from the estimate")
        figure.legend(
            handles=_legend(rows, method, beside, true), loc="outside upper left", ncols=5
        )
        told = "; ".join(
            f"{row.name} {row.change:+.3g} {row.unit.name}, interval ±{2 * row.estimate.standard_error:.2g}"
            for row in rows
        )
        return picture(
            figure,
            name="changes",
            alternative=f"Change of each parameter from its nominal value: {told}.",
            caption=(
                "Left: estimate minus nominal; intervals are ±2 standard errors, often shorter than the dot. "
                + (
                    "The bar is the nominal value's own stated uncertainty (±1): a dot far outside it is a surprise. "
                    if any(row.prior is not None for row in rows)
                    else ""
                )
                + (
                    "Right: what else is known, as a difference from the estimate in the estimate's standard errors; "
                    "the band is ±2."
                    + (
                        f" Beyond ±{_LINEAR:.0f} the scale is logarithmic."
                        if reach > _LINEAR * 1.5
                        else ""
                    )
                    if others
                    else ""
                )
            ),
        )


def _reach(rows: Sequence[Compared]) -> float:
    """Half width of the scale in standard errors."""
    far = [3.2]
    for row in rows:
        far += [
            abs(row.in_errors(other.value - row.estimate.value))
            + abs(row.in_errors(2 * other.standard_error))
            for other in row.beside
        ]
        if row.truth is not None:
            far.append(abs(row.in_errors(row.truth - row.estimate.value)))
    return float(min(np.nanmax(far), _FARTHEST)) * 1.15


def _names(axes: Axes, group: Sequence[Compared]) -> None:
    axes.set_yticks(range(len(group)), [row.name for row in group])
    axes.set_ylim(len(group) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0, labelcolor=INK)
    axes.spines["left"].set_visible(False)
    axes.grid(True, axis="x")


def _from_nominal(axes: Axes, group: Sequence[Compared], unit: str) -> None:
    _names(axes, group)
    axes.axvline(0.0, color=RULE, linewidth=1.0)
    for y, row in enumerate(group):
        if row.prior is not None:
            axes.barh(y, 2 * row.prior, left=-row.prior, height=0.55, color=BAND, linewidth=0)
        half = 2 * row.estimate.standard_error
        axes.plot([row.change - half, row.change + half], [y, y], color=AFTER, linewidth=2.0)
        axes.plot(
            row.change,
            y,
            "o",
            markersize=5,
            color=AFTER,
            markerfacecolor=PAPER if row.held else AFTER,
        )
    axes.set_xlabel(f"{unit}, estimate − nominal")


def _from_estimate(axes: Axes, group: Sequence[Compared], reach: float) -> None:
    _names(axes, group)
    axes.axvspan(-2, 2, color=BAND, linewidth=0)
    axes.axvline(0.0, color=AFTER, linewidth=1.0)
    for y, row in enumerate(group):
        shown = [
            (other, MARKERS[(k + 1) % len(MARKERS)], BESIDE, 0.16)
            for k, other in enumerate(row.beside)
        ]
        for other, marker, colour, lift in shown:
            at = row.in_errors(other.value - row.estimate.value)
            half = row.in_errors(2 * other.standard_error)
            ends = np.clip([at - half, at + half], -reach, reach)
            axes.plot(ends, [y + lift, y + lift], color=colour, linewidth=1.4)
            _mark(axes, at, y + lift, marker, colour, reach)
        if row.truth is not None:
            _mark(axes, row.in_errors(row.truth - row.estimate.value), y - 0.16, "x", TRUTH, reach)
    axes.set_xscale("symlog", linthresh=_LINEAR, linscale=1.0)
    axes.set_xlim(-reach, reach)
    decades = [10.0**k for k in range(1, 5) if 10.0**k <= reach]
    ticks = [-x for x in reversed(decades)] + [-2.0, 0.0, 2.0] + decades
    axes.set_xticks(ticks, [f"{x:.0f}".replace("-", "−") for x in ticks])
    axes.set_xlabel("standard errors of the estimate")


def _mark(axes: Axes, at: float, y: float, marker: str, colour: str, reach: float) -> None:
    if abs(at) > reach:
        marker, at = (">" if at > 0 else "<"), float(np.sign(at)) * reach * 0.985
    axes.plot(at, y, marker, color=colour, markersize=5, markerfacecolor=PAPER, markeredgewidth=1.4)


def _legend(
    rows: Sequence[Compared], method: str, beside: Sequence[str], true: bool
) -> list[Line2D | Patch]:
    out: list[Line2D | Patch] = [
        Line2D([], [], color=AFTER, marker="o", markersize=5, label=f"estimate ({method})")
    ]
    if any(row.prior is not None for row in rows):
        out.append(Patch(facecolor=BAND, label="stated uncertainty of nominal"))
    out += [
        Line2D(
            [],
            [],
            color=BESIDE,
            marker=MARKERS[(k + 1) % len(MARKERS)],
            markersize=5,
            markerfacecolor=PAPER,
            label=name,
        )
        for k, name in enumerate(beside)
    ]
    if true:
        out.append(
            Line2D([], [], color=TRUTH, marker="x", linestyle="", markersize=5, label="truth")
        )
    return out
