"""The gap on poses that took no part in the fit: before and after what was missing is added."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from solver.gap.held_out import HeldOut
from solver.report.notation import figures
from solver.report.pictures.canvas import AFTER, BEFORE, RULE, Picture, canvas, picture

Array = NDArray[np.float64]

_LEAST = 0.1
_STEPS = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000)


def held_out_picture(held: HeldOut, grown: bool) -> Picture:
    """The gap of every held-out dwell, and of all together.

    Args:
        held: the gap.
        grown: whether something was added, so that before and after differ.
    """
    series = [("before", BEFORE, held.each_before, held.before, held.before_error)]
    if grown:
        series.append(("after", AFTER, held.each_after, held.after, held.after_error))
    highest = max(float(np.nanmax(each)) for _, _, each, _, _ in series) ** 0.5
    with canvas(2.9) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(3.2, 1.0), sharey=True)
        for axes in (left, right):
            _scale(axes, highest)
        for number, (label, colour, each, whole, error) in enumerate(series):
            values = np.maximum(np.sqrt(each), _LEAST)
            left.plot(
                np.arange(len(values)),
                values,
                "o",
                color=colour,
                markersize=3.2,
                markeredgewidth=0,
                label=label,
            )
            right.errorbar(
                [number],
                [whole],
                yerr=[error],
                fmt="o",
                color=colour,
                markersize=6,
                capsize=3,
                elinewidth=1.2,
            )
            right.annotate(
                figures(whole),
                (number, whole),
                xytext=(9, 0),
                textcoords="offset points",
                va="center",
                color=colour,
                fontweight="bold",
            )
        left.set_xlabel("dwell, in order of recording")
        left.set_ylabel("gap (1 = noise alone)")
        left.set_title("Each held-out dwell")
        left.margins(x=0.02)
        left.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        right.set_title("All, ± standard error")
        right.set_xticks(range(len(series)), [label for label, *_ in series])
        right.set_xlim(-0.5, len(series) - 0.25)
        if grown:
            left.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.14))
        told = ", ".join(f"{label} {figures(whole)}" for label, _, _, whole, _ in series)
        return picture(
            figure,
            name="held-out",
            alternative=f"Gap on {held.poses} held-out dwells: {told}, where 1 is noise alone.",
            caption=(
                "How far the readings of poses that took no part in the fit lie from what the model says of them, "
                "in units of what noise and the uncertainty of the parameters explain, on a logarithmic scale that ends at 0.1. "
                "A fifth of the poses is held out at a time, with all their visits"
                + ("; what is missing is looked for anew in the rest." if grown else ".")
            ),
        )


def _scale(axes: Axes, highest: float) -> None:
    axes.set_yscale("log")
    axes.axhline(1.0, color=RULE, linewidth=1.2)
    axes.yaxis.set_major_locator(FixedLocator(_STEPS))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(0.8 * _LEAST, 1.6 * max(highest, 2.0))
