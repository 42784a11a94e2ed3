"""Sizes of effects as users write them: ``2%`` or a plain number."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim_devices.plant.errors import BadEffect


@dataclass(frozen=True, slots=True)
class Size:
    """``number`` as written; ``percent`` says that a percent sign followed."""

    number: float
    percent: bool


def parse_size(effect: str, text: str) -> Size:
    """Read a size; raises BadEffect when it is no finite number."""
    digits = text.strip()
    percent = digits.endswith("%")
    try:
        number = float(digits.removesuffix("%"))
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or number == 0.0:
        raise BadEffect(
            f"the size of '{effect}' is '{text}', expected a number other than 0, such as 0.5 or 2%"
        )
    return Size(number, percent)
