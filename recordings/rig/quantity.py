"""Physical quantities in rig files: a key carries its unit, a value may carry its uncertainty.

``s_mm = 355`` and ``s_m = { nominal = 0.355, uncertainty = 0.001, identify = true }`` both
describe the field ``s``. Inside the program everything is SI (metres, radians); the unit
is a matter of the file and of what is shown.

Refuses keys without a unit, two spellings of one quantity, and numbers that are not finite.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, model_validator
from pydantic_core import PydanticCustomError

DEGREE = math.pi / 180.0

UNITS: dict[str, tuple[str, float]] = {
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "rad": ("angle", 1.0),
    "deg": ("angle", DEGREE),
    "m_per_count": ("length/count", 1.0),
    "mm_per_count": ("length/count", 1e-3),
    "rad_per_count": ("angle/count", 1.0),
    "deg_per_count": ("angle/count", DEGREE),
    "counts": ("count", 1.0),
    "kg": ("mass", 1.0),
    "m_per_s2": ("acceleration", 1.0),
    "m_per_s": ("speed", 1.0),
    "deg_per_s": ("angular speed", DEGREE),
    "s": ("time", 1.0),
    "hz": ("frequency", 1.0),
    "1": ("ratio", 1.0),
    "percent": ("ratio", 0.01),
    "per_s": ("rate", 1.0),
    "ppm_per_s": ("rate", 1e-6),
    "rad_per_s": ("angular speed", 1.0),
    "m_per_N": ("compliance", 1.0),
    "mm_per_N": ("compliance", 1e-3),
    "rad_per_Nm": ("angular compliance", 1.0),
    "deg_per_Nm": ("angular compliance", DEGREE),
}
"""Accepted unit suffixes: dimension and factor to SI."""

SHOWN: dict[str, tuple[str, float]] = {
    "length": ("m", 1.0),
    "angle": ("deg", DEGREE),
    "length/count": ("m/count", 1.0),
    "angle/count": ("deg/count", DEGREE),
    "count": ("counts", 1.0),
    "ratio": ("1", 1.0),
    "time": ("s", 1.0),
    "rate": ("1/s", 1.0),
    "speed": ("m/s", 1.0),
    "angular speed": ("deg/s", DEGREE),
    "compliance": ("m/N", 1.0),
    "angular compliance": ("deg/Nm", DEGREE),
}
"""Unit in which results give a parameter of each dimension, with its factor to SI."""

LENGTH = ("m", "mm")
ANGLE = ("deg", "rad")
COORDINATE = ANGLE + LENGTH
GAIN = ("deg_per_count", "rad_per_count", "m_per_count", "mm_per_count")


@dataclass(frozen=True, slots=True)
class Tie:
    """This value equals ``factor`` times the parameter called ``parameter``."""

    parameter: str
    factor: float


@dataclass(frozen=True, slots=True)
class Quantity:
    """A value that may be uncertain, identified, or tied to another.

    Attributes:
        nominal: value before calibration, SI.
        dimension: what it measures ("length", "angle", ...), from the unit in its key.
        uncertainty: standard uncertainty of ``nominal``, SI, or None where none is stated.
        identify: whether a calibration estimates it.
        tie: set when the value follows another parameter (``nominal`` is then ignored).
    """

    nominal: float = 0.0
    dimension: str = ""
    uncertainty: float | None = None
    identify: bool = False
    tie: Tie | None = None


@dataclass(frozen=True, slots=True)
class Range:
    """A closed interval [low, high], SI."""

    low: float
    high: float
    dimension: str


def fail(message: str) -> PydanticCustomError:
    """A validation error whose text is ``message`` as it stands."""
    return PydanticCustomError("rig", "{message}", {"message": message})


class Described(BaseModel):
    """A table of a rig file: strict about its keys, aware of units.

    Subclasses list in ``quantities`` which fields are physical, with the units each may be
    given in. Such a field is a `Quantity` (a number or a table), a `Range` (two numbers), a
    ``float``, three floats (a vector), or rows of floats.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, arbitrary_types_allowed=True, strict=True
    )
    quantities: ClassVar[dict[str, tuple[str, ...]]] = {}

    @model_validator(mode="before")
    @classmethod
    def _read_units(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        keys = {field.alias or name: name for name, field in cls.model_fields.items()}
        plain = [key for key, name in keys.items() if name not in cls.quantities]
        spelled = {
            f"{name}_{unit}": (name, unit)
            for name, units in cls.quantities.items()
            for unit in units
        }
        out: dict[str, Any] = {}
        came_from: dict[str, str] = {}
        for key, value in table.items():
            if key in spelled:
                name, unit = spelled[key]
                if name in came_from:
                    raise fail(
                        f"'{key}' and '{came_from[name]}' say the same thing; keep one of them"
                    )
                came_from[name] = key
                reader = _READERS.get(cls.model_fields[name].annotation, _READERS[float])
                out[name] = reader(key, value, unit)
            elif key in plain:
                out[key] = tuple(value) if isinstance(value, list) else value
            elif key in cls.quantities:
                raise fail(f"'{key}' needs its unit in the key: {cls.spellings(key)}")
            else:
                allowed = sorted([*plain, *spelled])
                near = difflib.get_close_matches(key, allowed, n=1)
                hint = f" did you mean '{near[0]}'?" if near else ""
                raise fail(f"unknown key '{key}';{hint} allowed here: {', '.join(allowed)}")
        for key, name in keys.items():
            if cls.model_fields[name].is_required() and name not in out and key not in out:
                wanted = cls.spellings(name) if name in cls.quantities else key
                raise fail(f"missing key '{wanted}'")
        return out

    @classmethod
    def spellings(cls, name: str) -> str:
        """The keys under which a file may give the quantity ``name``, for a message."""
        return " or ".join(f"{name}_{unit}" for unit in cls.quantities[name])


def _finite(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise fail(f"'{key}' is {value!r}, expected a finite number")
    # TOML integers have any size; one beyond the floats would not convert.
    if not abs(value) <= sys.float_info.max:
        raise fail(f"'{key}' is {value!r:.40}, expected a finite number")
    return float(value)


def _number(key: str, value: Any, unit: str) -> float:
    return _finite(key, value) * UNITS[unit][1]


def _vector(key: str, value: Any, unit: str) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != 3:
        raise fail(f"'{key}' is {value!r}, expected three numbers [x, y, z]")
    return tuple(_number(key, item, unit) for item in value)


def _rows(key: str, value: Any, unit: str) -> tuple[tuple[float, ...], ...]:
    if not isinstance(value, list) or not value or not all(isinstance(row, list) for row in value):
        raise fail(f"'{key}' is {value!r}, expected rows of numbers [[...], ...]")
    return tuple(tuple(_number(key, item, unit) for item in row) for row in value)


def _range(key: str, value: Any, unit: str) -> Range:
    if not isinstance(value, list) or len(value) != 2:
        raise fail(f"'{key}' is {value!r}, expected [lowest, highest]")
    low, high = (_number(key, item, unit) for item in value)
    if not low < high:
        raise fail(f"'{key}' is {value!r}, expected the lowest first")
    return Range(low, high, UNITS[unit][0])


def read_quantity(key: str, value: Any, unit: str) -> Quantity:
    """The quantity that ``key``, whose suffix is ``unit``, gives: a number or a table."""
    dimension, factor = UNITS[unit]
    if not isinstance(value, dict):
        return Quantity(_finite(key, value) * factor, dimension)
    allowed = {"nominal", "uncertainty", "identify", "tie"}
    for inner in value:
        if inner not in allowed:
            raise fail(
                f"'{key}' has the unknown key '{inner}'; allowed here: {', '.join(sorted(allowed))}"
            )
    if "tie" in value:
        if len(value) > 1:
            raise fail(f"'{key}' is tied, so it takes no other key beside 'tie'")
        return Quantity(dimension=dimension, tie=_tie(key, value["tie"]))
    if "nominal" not in value:
        raise fail(f"'{key}' has no 'nominal' (its value before calibration)")
    nominal = _finite(f"{key}.nominal", value["nominal"]) * factor
    uncertainty = None
    if "uncertainty" in value:
        uncertainty = _finite(f"{key}.uncertainty", value["uncertainty"]) * factor
        if uncertainty <= 0:
            raise fail(f"'{key}.uncertainty' is {value['uncertainty']}, expected a number above 0")
    identify = value.get("identify", False)
    if not isinstance(identify, bool):
        raise fail(f"'{key}.identify' is {identify!r}, expected true or false")
    return Quantity(nominal, dimension, uncertainty, identify)


def _tie(key: str, text: Any) -> Tie:
    """Read ``"A2.x"``, ``"-A2.x"`` or ``"2 * A2.x"``."""
    if isinstance(text, str):
        head, star, name = text.rpartition("*")
        name, head = name.strip(), head.strip()
        sign = 1.0
        if not star and name.startswith("-"):
            sign, name = -1.0, name[1:].strip()
        if name:
            with contextlib.suppress(ValueError):
                factor = float(head) if star else sign
                if math.isfinite(factor):
                    return Tie(parameter=name, factor=factor)
    raise fail(
        f'\'{key}.tie\' is {text!r}, expected a parameter name such as "A2.x", "-A2.x" or "2 * A2.x"'
    )


_READERS: dict[Any, Callable[[str, Any, str], Any]] = {
    float: _number,
    Quantity: read_quantity,
    Quantity | None: read_quantity,
    Range: _range,
    Range | None: _range,
    float | None: _number,
    tuple[float, float, float] | None: _vector,
    tuple[float, float, float]: _vector,
    tuple[tuple[float, ...], ...] | None: _rows,
}
