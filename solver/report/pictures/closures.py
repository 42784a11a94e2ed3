"""Closure errors of a hinged arm, pose by pose, against what sensor noise alone would leave."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from solver.closure import ClosureErrors
from solver.report.notation import figures
from solver.report.pictures.canvas import (
    AFTER,
    BEFORE,
    INK,
    PAPER,
    Picture,
    canvas,
    decades,
    picture,
)

Array = NDArray[np.float64]


def closures(before: ClosureErrors, after: ClosureErrors, poses: NDArray[np.intp]) -> Picture:
    """Length of the closure error at each of ``poses`` (n,), position and orientation."""
    with canvas(2.9) as figure:
        left, right = figure.subplots(1, 2, sharex=True)
        _panel(
            left,
            poses,
            _length(before.position) * 1e3,
            _length(after.position) * 1e3,
            np.sqrt(3) * after.position_predicted * 1e3,
        )
        left.set_title("Position")
        left.set_ylabel("mm")
        _panel(
            right,
            poses,
            _length(before.orientation) * 1e3,
            _length(after.orientation) * 1e3,
            np.sqrt(2) * after.orientation_predicted * 1e3,
        )
        right.set_title("Orientation")
        right.set_ylabel("mrad")
        for axes in (left, right):
            axes.set_xlabel("pose, in order of recording")
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=3)
        return picture(
            figure,
            name="closures",
            alternative=(
                f"Closure errors of {len(poses)} poses on a logarithmic scale. Position: RMS of a component "
                f"{figures(before.position_rms * 1e3)} mm before, {figures(after.position_rms * 1e3)} mm after, "
                f"noise alone {figures(after.position_predicted * 1e3)} mm. Orientation: "
                f"{figures(before.orientation_rms * 1e3)} mrad before, {figures(after.orientation_rms * 1e3)} mrad after, "
                f"noise alone {figures(after.orientation_predicted * 1e3)} mrad."
            ),
            caption=(
                "By how far the loop fails to close at each pose used, with the readings taken as they are. "
                "Logarithmic scale. The line is the root mean square that sensor noise alone would leave; "
                "after a good calibration the points scatter about it."
            ),
        )


def _length(errors: Array) -> Array:
    length: Array = np.linalg.norm(errors, axis=1)
    return length


def _panel(
    axes: Axes, poses: NDArray[np.intp], before: Array, after: Array, predicted: float
) -> None:
    axes.plot(
        poses,
        before,
        "v",
        color=BEFORE,
        markersize=3.6,
        markerfacecolor=PAPER,
        markeredgewidth=1.0,
        label="before, at nominal parameters",
    )
    axes.plot(
        poses, after, "o", color=AFTER, markersize=3.2, markeredgewidth=0, label="after calibration"
    )
    axes.axhline(predicted, color=INK, linewidth=1.0, linestyle="--", label="noise alone")
    decades(axes)
    axes.margins(x=0.02)
