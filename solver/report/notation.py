"""How results are written for people: units they think in, and as many digits as the error deserves."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from markupsafe import Markup, escape

from recordings.rig import Parameter

_READABLE: dict[str, tuple[str, float]] = {
    "length": ("mm", 1e-3),
    "angle": ("deg", math.pi / 180.0),
    "length/count": ("mm/count", 1e-3),
    "angle/count": ("deg/count", math.pi / 180.0),
    "count": ("counts", 1.0),
    "ratio": ("%", 1e-2),
    "time": ("ms", 1e-3),
    "rate": ("ppm/s", 1e-6),
    "speed": ("mm/s", 1e-3),
    "angular speed": ("deg/s", math.pi / 180.0),
    "compliance": ("mm/N", 1e-3),
    "angular compliance": ("deg/Nm", math.pi / 180.0),
}
_MOST_DECIMALS = 9
_DECIMALS_WITHOUT_ERROR = 4


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit by name, with its factor to SI."""

    name: str
    to_si: float


def unit_of(parameter: Parameter) -> Unit:
    """The unit in which people read ``parameter``: mm and deg."""
    return unit_for(parameter.dimension)


def unit_for(dimension: str) -> Unit:
    """The unit in which people read a ``dimension`` of the parameter table."""
    return Unit(*_READABLE[dimension])


def fine_unit(dimension: str, size_si: float) -> Unit:
    """The unit of length or angle in which ``size_si`` is easy to read."""
    ladder = {
        "length": (Unit("mm", 1e-3), Unit("µm", 1e-6)),
        "angle": (Unit("deg", math.pi / 180.0), Unit("mdeg", math.pi / 180e3)),
    }[dimension]
    return next((unit for unit in ladder if abs(size_si) >= 0.1 * unit.to_si), ladder[-1])


def decimals_for(standard_error: float) -> int:
    """Decimals that show two significant digits of ``standard_error``."""
    if not (math.isfinite(standard_error) and standard_error > 0):
        return _DECIMALS_WITHOUT_ERROR
    return min(max(1 - math.floor(math.log10(standard_error)), 0), _MOST_DECIMALS)


def fixed(value: float, decimals: int) -> str:
    """``value`` with that many decimals, or a dash where there is no number; never minus zero."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def signed(value: float, decimals: int) -> str:
    """As `fixed`, with a plus sign where positive."""
    text = fixed(value, decimals)
    return f"+{text}" if value > 0 and float(text) != 0 else text


def plain(value: float) -> str:
    """A stated number as it was stated, free of what conversion to SI and back adds."""
    return f"{value:.10g}" if value else "0"


def figures(value: float, count: int = 3) -> str:
    """``value`` with ``count`` significant figures, in plain notation while that is short."""
    if not math.isfinite(value):
        return "∞" if math.isinf(value) else "–"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{count - 1}e}"))))
    if -4 <= exponent < 6:
        return f"{value:.{max(count - 1 - exponent, 0)}f}"
    return f"{value / 10.0**exponent:.{count - 1}f}×10{str(exponent).translate(_SUPERSCRIPT)}"


_MINUS = re.compile(r"(?<![\w-])-(?=\d)")
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(text: str) -> str:
    """``text`` with true minus signs before its numbers, for a page."""
    return _MINUS.sub("−", text)


def coded(text: str) -> Markup:
    """``text`` for a page, with what stands between backquotes as code."""
    parts = [escape(part) for part in text.split("`")]
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if odd % 2 else part
        for odd, part in enumerate(parts)
    )
