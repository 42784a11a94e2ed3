"""Singular values of the identification Jacobians, raw and with unit columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.poses.observability import Observability
from solver.report.notation import figures
from solver.report.pictures.canvas import AFTER, BESIDE, INK, PAPER, Picture, canvas, picture

_MARKERS = ("o", "D", "s", "^", "v")


def singular_values(
    methods: Sequence[str],
    raw: Sequence[Observability],
    scaled: Sequence[Observability],
    acceptable: float,
) -> Picture:
    """Singular values of each method's Jacobian, the chosen method first.

    Args:
        methods: their names.
        raw: of the Jacobians with SI columns.
        scaled: of the Jacobians with unit columns.
        acceptable: the largest scaled condition number that counts as acceptable.
    """
    with canvas(2.7) as figure:
        left, right = figure.subplots(1, 2)
        for axes, of in ((left, raw), (right, scaled)):
            for k, (method, one) in enumerate(zip(methods, of, strict=True)):
                values = np.where(one.singular_values > 0, one.singular_values, np.nan)
                axes.semilogy(
                    np.arange(1, len(values) + 1),
                    values,
                    marker=_MARKERS[k % len(_MARKERS)],
                    markersize=4.2,
                    linewidth=0.8,
                    color=AFTER if k == 0 else BESIDE,
                    markerfacecolor=AFTER if k == 0 else PAPER,
                    label=method,
                )
            axes.set_xlabel("number, largest first")
            axes.grid(True, axis="y")
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
            f"{method}: condition number {figures(r.condition)} raw, {figures(s.condition)} scaled"
            for method, r, s in zip(methods, raw, scaled, strict=True)
        )
        return picture(
            figure,
            name="singular-values",
            alternative=f"Singular values on a logarithmic scale. {told}.",
            caption=(
                "Singular values of the Jacobian from the poses used, logarithmic scale. A steep fall at the end means a "
                f"combination of parameters that these poses barely show. With unit columns, everything above σ₁ / {acceptable:.0f} is acceptable."
            ),
        )
