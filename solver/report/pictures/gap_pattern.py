"""The strangest pattern of no known effect: one channel against the rest of the loop, and the pattern in it."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator

from solver.gap.fit import Fit
from solver.gap.unknown import Pattern, followed
from solver.report.notation import Unit, fine_unit
from solver.report.pictures.canvas import BEFORE, INK, RULE, Picture, canvas, picture

_WIDE = 1.15  # times the farthest point


def pattern_picture(fit: Fit, found: Pattern, words: str) -> Picture | None:
    """``found`` in the residual of ``fit``; None for a pattern over the pose, which the maps show.

    Args:
        fit: the model behind which the pattern was found.
        found: the pattern.
        words: what it is called.
    """
    seen = followed(fit, found)
    if seen is None:
        return None
    c = fit.model.channels.index(found.channel)
    rig = fit.model.site.rig
    kind = rig.dimension_of(rig.channels[c].senses)
    order = np.argsort(seen.along, kind="stable")
    x, line = seen.along[order], seen.seen[order]
    dots = line + seen.beside[order]
    unit = fine_unit(kind, float(np.sqrt(np.nanmean(dots**2))))
    if found.over == "move":
        step = Unit("deg", np.pi / 180.0) if kind == "angle" else Unit("mm", 1e-3)
        x, label = x / step.to_si, f"{found.channel}: how far it went to get there [{step.name}]"
    else:
        x, label = (x - x[0]) / 60.0, "time [min]"
    with canvas(2.5) as figure:
        axes = figure.subplots()
        axes.axhline(0.0, color=RULE, linewidth=0.8)
        axes.plot(
            x,
            dots / unit.to_si,
            "o",
            color=BEFORE,
            markersize=3.2,
            markeredgewidth=0,
            label="and what is left beside it",
        )
        # Over the moves a pattern has a second one to remember, and is no line.
        style = "_" if found.over == "move" else "-"
        axes.plot(x, line / unit.to_si, style, color=INK, label="the pattern")
        reach = _WIDE * float(np.nanmax(np.abs(dots))) / unit.to_si
        axes.set_ylim(-reach, reach)
        axes.margins(x=0.02)
        axes.xaxis.set_major_locator(MaxNLocator(8))
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.set_xlabel(label)
        axes.set_ylabel(f"{found.channel} [{unit.name}]")
        axes.set_title(words)
        axes.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.17), reverse=True)
        return picture(
            figure,
            name="pattern",
            alternative=f"The pattern of {words}, and what is left beside it.",
            caption=(
                f"What {found.channel} would have to see beyond its true value, with the known effects that come near taken "
                "into the model; and around it what is left then of its disagreement with all other readings of the same "
                "pose. Another channel of the loop may be at fault: all of them share its misfit."
            ),
        )
