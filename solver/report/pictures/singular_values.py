"""Singular values of the identification Jacobians, raw and with unit columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.report.judged import Judged
from solver.report.notation import figures
from solver.report.pictures.canvas import (
    AFTER,
    BESIDE,
    INK,
    MARKERS,
    PAPER,
    Picture,
    canvas,
    decades,
    picture,
)


def singular_values(
    jacobians: Sequence[Judged], methods: Sequence[str], acceptable: float
) -> Picture:
    """Singular values of each of ``jacobians``, the one that judges the poses first.

    Args:
        jacobians: their observability.
        methods: names of the methods, the chosen one first.
        acceptable: the largest scaled condition number that counts as acceptable.
    """
    raw, scaled = [one.raw for one in jacobians], [one.scaled for one in jacobians]
    with canvas(2.7) as figure:
        left, right = figure.subplots(1, 2)
        for axes, of in ((left, raw), (right, scaled)):
            for k, (jacobian, one) in enumerate(zip(jacobians, of, strict=True)):
                place = methods.index(jacobian.method)
                colour = AFTER if place == 0 else BESIDE
                values = np.where(one.singular_values > 0, one.singular_values, np.nan)
                axes.plot(
                    np.arange(1, len(values) + 1),
                    values,
                    marker=MARKERS[place % len(MARKERS)],
                    markersize=4.2,
                    linewidth=0.8,
                    color=colour,
                    markerfacecolor=colour if k == 0 else PAPER,
                    label=f"{jacobian.method}: {jacobian.residual}",
                )
            axes.set_xlabel("number, largest first")
            decades(axes)
        left.set_title("Raw (SI columns)")
        right.set_title("Scaled (unit columns)")
        floor = float(scaled[0].singular_values[:1].sum()) / acceptable
        if floor > 0:
            right.axhline(floor, color=INK, linewidth=1.0, linestyle="--")
            right.annotate(
                f"σ₁ / {acceptable:.0f}",
                (1.0, floor),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                fontsize=8.5,
                color=INK,
            )
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=4)
        told = "; ".join(
            f"{one.method}: condition number {figures(one.raw.condition)} raw, {figures(one.scaled.condition)} scaled"
            for one in jacobians
        )
        return picture(
            figure,
            name="singular-values",
            alternative=f"Singular values on a logarithmic scale. {told}.",
            caption=(
                "Singular values of the Jacobians from the poses used, logarithmic scale; the filled one judges the poses. A steep fall at the end means a "
                f"combination of parameters that these poses barely show. With unit columns, its values above σ₁ / {acceptable:.0f} are acceptable."
            ),
        )
