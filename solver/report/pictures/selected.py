"""Which poses were used, among all that were recorded."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from solver.report.notation import Unit, unit_for
from solver.report.pictures.canvas import AFTER, MUTED, PAPER, Picture, canvas, picture
from solver.solve import Solution

Array = NDArray[np.float64]

_PANELS = 3


def selected(solution: Solution) -> Picture:
    """Selected poses among all, in planes of readings and along the principal axes of all readings."""
    readings, units = _readings(solution)
    names = solution.table.channels
    used = np.isin(np.arange(len(readings)), solution.selection.poses)
    planes = _planes(solution)[: _PANELS - 1]
    with canvas(2.95) as figure:
        panels = figure.subplots(1, len(planes) + 1, squeeze=False)[0]
        for axes, (a, b) in zip(panels, planes, strict=False):
            _scatter(axes, readings[:, a], readings[:, b], used)
            axes.set_xlabel(f"{names[a]} [{units[a].name}]")
            axes.set_ylabel(f"{names[b]} [{units[b].name}]")
        if len(names) > 1:
            along, shares = _principal(readings)
            _scatter(panels[-1], along[:, 0], along[:, 1], used)
            panels[-1].set_xlabel(f"principal axis 1 ({shares[0]:.0%} of the spread)")
            panels[-1].set_ylabel(f"principal axis 2 ({shares[1]:.0%})")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=2)
        shown = ", ".join(f"{names[a]} and {names[b]}" for a, b in planes)
        return picture(
            figure,
            name="selected",
            alternative=f"{used.sum()} selected poses among {len(used)}, in the readings {shown} and along the two principal axes of all readings.",
            caption=(
                f"Readings at all {len(used)} poses"
                + (f" ({shown})" if shown else "")
                + "; at the right, along the two directions in which all readings, each divided by its spread, vary most. "
                "Poses at the rim of the workspace usually tell most."
            ),
        )


def _readings(solution: Solution) -> tuple[Array, list[Unit]]:
    """(P, C) calibrated readings, each in its unit."""
    rig = solution.rig
    units = [unit_for(rig.dimension_of(channel.senses)) for channel in rig.channels]
    value = dict(
        zip(
            (p.name for p in solution.estimate.space.table),
            solution.estimate.parameters,
            strict=True,
        )
    )
    columns = []
    for c, (channel, unit) in enumerate(zip(solution.rig.channels, units, strict=True)):
        counts = solution.table.counts[:, c] - channel.zero_count
        columns.append(
            (value[f"{channel.name}.gain"] * counts + value[f"{channel.name}.offset"]) / unit.to_si
        )
    return np.stack(columns, axis=1), units


def _planes(solution: Solution) -> list[tuple[int, int]]:
    """Pairs of channels worth a panel: those of the drives, which set the pose, else neighbours."""
    names = solution.table.channels
    plan = solution.rig.plan
    if plan is not None and len(plan.drives) == 2:
        sensed = [solution.rig.sensed_by(joint) for joint in plan.drives]
        return [(names.index(a.name), names.index(b.name)) for a, b in [sensed] if a and b]
    return [(c, c + 1) for c in range(0, len(names) - 1, 2)]


def _principal(readings: Array) -> tuple[Array, Array]:
    """(P, C) readings along their principal axes, and each axis' share of the variance."""
    centred = readings - readings.mean(axis=0)
    spread = centred.std(axis=0)
    left, singular, right = np.linalg.svd(
        centred / np.where(spread > 0, spread, 1.0), full_matrices=False
    )
    # The sign of an axis is arbitrary: its largest member counts positive.
    sign = np.sign(right[np.arange(len(right)), np.argmax(np.abs(right), axis=1)])
    return left * singular * sign, singular**2 / max(float(np.sum(singular**2)), 1e-300)


def _scatter(axes: Axes, x: Array, y: Array, used: NDArray[np.bool_]) -> None:
    axes.plot(
        x[~used],
        y[~used],
        "o",
        color=MUTED,
        markersize=4,
        markerfacecolor=PAPER,
        markeredgewidth=0.9,
        label="not used" if not used.all() else None,
    )
    axes.plot(x[used], y[used], "o", color=AFTER, markersize=4, markeredgewidth=0, label="used")
    axes.margins(0.06)
