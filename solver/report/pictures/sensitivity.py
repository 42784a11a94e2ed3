"""How far each parameter's error moves the endpoint or plate: Figure 3 of the shoulder's paper, for all of them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from solver.report.notation import figures
from solver.report.pictures.canvas import (
    AFTER,
    BEFORE,
    INK,
    PAPER,
    RULE,
    Picture,
    canvas,
    picture,
)
from solver.sensitivity import Sensitivity

Array = NDArray[np.float64]

_MOST = 40
_NOTHING = 1e-9  # of the largest effect: only rounding
_DEG = np.pi / 180.0


def sensitivity_picture(found: Sensitivity, standard_errors: Array | None = None) -> Picture:
    """The endpoint's or plate's error at the plausible error of each parameter, largest first.

    Args:
        found: of n parameters.
        standard_errors: (n,) after a calibration, SI; nan for a parameter that it did not identify.
    """
    panels = []
    if found.shifts:
        rms, most = found.displacement_rms, found.displacement_max
        panels.append(("Displacement", "mm", 1e-3, _real(rms), most))
    if found.turns:
        rms, most = found.rotation_rms, found.rotation_max
        panels.append(("Rotation", "deg", _DEG, _real(rms), most))
    ranks = [rms / rms.max() for *_, rms, _ in panels]
    size = np.max(ranks, axis=0) if ranks else np.zeros(len(found.errors))
    order = np.argsort(-size, kind="stable")
    rows = order[: min(_MOST, int((size > 0).sum()))]
    left = [found.space.names[i] for i in np.flatnonzero(size == 0)]
    kept = np.full(len(found.errors), np.nan) if standard_errors is None else standard_errors
    with canvas(0.95 + 0.2 * len(rows)) as figure:
        grid = figure.subplots(1, max(len(panels), 1), squeeze=False, sharey=True)[0]
        for axes, (title, unit, factor, rms, most) in zip(grid, panels, strict=False):
            _marks(axes, rms[rows] / factor, most[rows] / factor, found.stated[rows])
            after = (rms * kept / found.errors)[rows] / factor
            shown = after > 0
            axes.plot(after[shown], np.flatnonzero(shown), "o", color=AFTER, markersize=5)
            _scale(axes)
            axes.set_title(title)
            axes.set_xlabel(f"{unit}, RMS over {found.poses} poses")
        grid[0].set_yticks(range(len(rows)), [found.space.names[i] for i in rows])
        grid[0].set_ylim(len(rows) - 0.4, -0.6)
        figure.legend(
            handles=_legend(found.stated[rows], bool(np.isfinite(kept[rows]).any())),
            loc="outside upper left",
            ncols=4,
        )
        return picture(
            figure,
            name="sensitivity",
            alternative=_told(found, rows),
            caption=_caption(found, left, len(order) - len(rows) - len(left)),
        )


def _real(rms: Array) -> Array:
    """``rms`` (n,) with zeros for what is only rounding."""
    return np.where(rms > _NOTHING * rms.max(), rms, 0.0)


def _marks(axes: Axes, rms: Array, most: Array, stated: NDArray[np.bool_]) -> None:
    y = np.arange(len(rms))
    there = rms > 0
    axes.hlines(y[there], rms[there], most[there], color=BEFORE, linewidth=1.4)
    axes.plot(most[there], y[there], "|", color=BEFORE, markersize=7, markeredgewidth=1.4)
    for known, face in ((True, BEFORE), (False, PAPER)):
        shown = there & (stated == known)
        axes.plot(rms[shown], y[shown], "o", color=BEFORE, markersize=5, markerfacecolor=face)


def _scale(axes: Axes) -> None:
    """A logarithmic scale, once everything is drawn; with 2 and 5 on it where it is short."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    few = high < 100.0 * low
    axes.xaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: figures(value, 1).removeprefix("1×"))
    )
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(True, axis="x")
    axes.grid(True, axis="y", color=RULE, linewidth=0.3)
    axes.tick_params(axis="y", length=0, labelcolor=INK)
    axes.spines["left"].set_visible(False)


def _legend(stated: NDArray[np.bool_], solved: bool) -> list[Line2D]:
    out = []
    if stated.any():
        out.append(
            Line2D(
                [], [], color=BEFORE, marker="o", markersize=5, label="at its stated uncertainty"
            )
        )
    if not stated.all():
        out.append(
            Line2D(
                [],
                [],
                color=BEFORE,
                marker="o",
                markersize=5,
                markerfacecolor=PAPER,
                label="none stated: at 1 mm, 1 deg or 1 %",
            )
        )
    if solved:
        out.append(
            Line2D(
                [],
                [],
                color=AFTER,
                marker="o",
                markersize=5,
                linestyle="",
                label="at its standard error after this solve",
            )
        )
    return out


def _told(found: Sensitivity, rows: NDArray[np.intp]) -> str:
    parts = []
    for i in rows:
        name, (unit, size) = found.space.names[i], found.steps[i]
        effects = []
        if found.shifts:
            effects.append(f"{figures(found.displacement_rms[i] * 1e3, 2)} mm")
        if found.turns:
            effects.append(f"{figures(found.rotation_rms[i] / _DEG, 2)} deg")
        parts.append(
            f"{name} {' and '.join(effects)} at {figures(found.errors[i] / size, 2)} {unit}"
        )
    return (
        f"Error of the endpoint or plate from an error of each parameter alone: {'; '.join(parts)}."
    )


def _caption(found: Sensitivity, left: list[str], unseen: int) -> str:
    text = (
        "Error of the endpoint or plate if one parameter alone were wrong, at the same readings: the dot is the "
        "RMS over the poses, the line ends at the worst of them. Logarithmic scale, largest first. "
        "Errors of several parameters may undo each other."
    )
    if unseen:
        text += f" {unseen} smaller ones are not shown."
    if left:
        text += f" Without any effect there: {', '.join(left)}."
    return text
