"""Sizes of effects as users write them (``2%`` or a plain number), and the units they are told in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from recordings.rig import Rig
from recordings.rig.quantity import SHOWN
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


def ratio_size(effect: str, text: str, most: float) -> float:
    """Read a ratio, as a number or in percent, of at most ``most`` either way; raises BadEffect."""
    size = parse_size(effect, text)
    ratio = size.number / 100 if size.percent else size.number
    if not -most <= ratio <= most:
        raise BadEffect(
            f"the size of '{effect}' is '{text}', expected at most {most:g} (or {100 * most:g}%) either way"
        )
    return ratio


def number_size(effect: str, text: str, unit: str, most: float, signed: bool = False) -> float:
    """Read a plain number in ``unit``, above 0 unless ``signed``, of at most ``most``; raises BadEffect."""
    size = parse_size(effect, text)
    least = -most if signed else 0.0
    if size.percent or not least <= size.number <= most:
        sign = "either way" if signed else "and above 0"
        raise BadEffect(
            f"the size of '{effect}' is '{text}', expected a number in {unit}, at most {most:g} {sign}"
        )
    return size.number


def channel_unit(rig: Rig, channel: str) -> tuple[str, float]:
    """Unit in which sizes at ``channel`` are told, "deg" or "m", with its factor to SI."""
    return SHOWN[rig.dimension_of(rig.channel(channel).senses)]


def per_second(rig: Rig, channel: str) -> tuple[str, float]:
    """Unit of a rate at ``channel``, "deg/s" or "m/s", with its factor to SI."""
    unit, to_si = channel_unit(rig, channel)
    return f"{unit}/s", to_si
