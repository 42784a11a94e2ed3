"""Pictures as inline SVG: one look for all, in colours that follow the page's light or dark theme.

A picture is drawn with stand-in colours; the SVG then names the page's colour variables in
their place. Texts stay texts, in the page's own font. The same data give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from solver.report.notation import figures

INK = "#010101"
MUTED = "#020202"
RULE = "#030303"
PAPER = "#040404"
BAND = "#050505"
BEFORE = "#060606"
AFTER = "#070707"
BESIDE = "#080808"
TRUTH = "#090909"

_VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    RULE: "rule",
    PAPER: "paper",
    BAND: "band",
    BEFORE: "before",
    AFTER: "after",
    BESIDE: "beside",
    TRUTH: "truth",
}

MARKERS = ("o", "D", "s", "^", "v")
"""Of the methods: the chosen one's first, then those beside it in their order."""

WIDTH = 9.0  # inches; 72 SVG points each

_LOOK: dict[Any, Any] = {  # matplotlib types its keys one by one
    "svg.fonttype": "none",
    "svg.hashsalt": "loopcal",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": RULE,
    "axes.labelcolor": MUTED,
    "axes.facecolor": "none",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.axisbelow": True,
    "axes.grid": False,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": RULE,
    "ytick.color": RULE,
    "xtick.labelcolor": MUTED,
    "ytick.labelcolor": MUTED,
    "xtick.labelsize": 8.5,
    "xtick.major.size": 2.5,
    "xtick.minor.size": 0.0,
    "ytick.major.size": 2.5,
    "ytick.minor.size": 0.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "ytick.labelsize": 8.5,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.markeredgewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.labelcolor": INK,
}


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure of a report.

    Attributes:
        name: its identifier in the page.
        svg: the drawing, ready to stand in HTML.
        caption: what it shows and how to read it.
    """

    name: str
    svg: str
    caption: str


@contextmanager
def canvas(height: float, *, arranged: bool = True) -> Iterator[Figure]:
    """A figure in the common look, which holds while it is drawn.

    Args:
        height: in inches.
        arranged: whether the panels make room for their labels by themselves, which takes
            long where there are many.
    """
    # The look must not leak into a program that draws pictures of its own.
    with mpl.rc_context(_LOOK):
        yield Figure(figsize=(WIDTH, height), layout="constrained" if arranged else None)


def decades(axes: Axes) -> None:
    """A logarithmic vertical scale with a plain number at each power of ten."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(10.0, numticks=8))
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda value, _: figures(value, 1).removeprefix("1×"))
    )
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    axes.grid(True, axis="y")


def picture(figure: Figure, *, name: str, alternative: str, caption: str) -> Picture:
    """``figure`` as a `Picture`; ``alternative`` tells those who cannot see it what it shows."""
    buffer = io.StringIO()
    with mpl.rc_context(_LOOK):
        # `Figure.savefig` would draw everything twice.
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
    return Picture(name, _inline(buffer.getvalue(), name, alternative), caption)


def _inline(svg: str, name: str, alternative: str) -> str:
    """A stand-alone SVG document as an element of a page."""
    drawing = svg[svg.index("<svg") :]
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    drawing = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", drawing, flags=re.DOTALL)
    inner = re.sub(r'<g id="[^"]*">', "<g>", drawing[drawing.index(">") + 1 :])
    box = re.search(r'viewBox="([^"]+)"', drawing)
    if box is None:
        raise ValueError("the SVG has no viewBox; matplotlib's SVG writer always gives one")
    # Identifiers must be unique in a page that holds several drawings.
    inner = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', inner)
    inner = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", inner)
    inner = re.sub(r'xlink:href="#([^"]+)"', rf'href="#{name}-\1"', inner)
    for colour, variable in _VARIABLES.items():
        inner = inner.replace(colour, f"var(--{variable})")
    inner = re.sub(r"'DejaVu Sans'(, [^;\"]*)?", "var(--font)", inner)
    # Without a size in points the drawing takes the width of its column.
    return (
        f'<svg viewBox="{box.group(1)}" role="img" aria-label="{escape(alternative)}" '
        f'preserveAspectRatio="xMidYMid meet">{inner}'
    )
