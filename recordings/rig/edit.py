"""Putting calibrated values into the text of a rig file, comments and layout kept.

Owns where in the document a parameter stands. Refuses to change anything but nominal values
and their uncertainties, and to add anything but effects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import tomlkit

from recordings.errors import RigError
from recordings.rig.effect import DescribedEffect
from recordings.rig.quantity import UNITS, Quantity

_DIGITS = 10
_UNCERTAINTY_DIGITS = 4
PLAIN = {
    "length": "m",
    "angle": "deg",
    "length/count": "m_per_count",
    "angle/count": "deg_per_count",
    "count": "counts",
    "time": "s",
    "rate": "per_s",
    "speed": "m_per_s",
    "angular speed": "deg_per_s",
    "compliance": "m_per_N",
    "angular compliance": "deg_per_Nm",
}
"""Unit suffix of a key that is written anew, by dimension; a ratio takes none."""


@dataclass(frozen=True, slots=True)
class Calibrated:
    """A calibrated value and its standard error, SI, and what it measures."""

    value: float
    standard_error: float | None
    dimension: str


def with_values(text: str, values: Mapping[str, Calibrated]) -> str:
    """The rig file ``text`` with new nominal values, and standard errors as their uncertainties.

    Args:
        text: a valid rig description.
        values: by parameter name; tied parameters follow by themselves and must not be given.

    Raises:
        RigError: the rig has no such parameter.
    """
    document: Any = tomlkit.parse(text)
    owners = dict(_owners(document))
    for name, calibrated in values.items():
        owner, _, part = name.rpartition(".")
        if owner not in owners:
            raise RigError(f"the rig has nothing called '{owner}' to take the value of '{name}'")
        _set(owners[owner], part, calibrated)
    return tomlkit.dumps(document)


def with_effect(text: str, effect: DescribedEffect, remarks: Sequence[str] = ()) -> str:
    """The rig file ``text`` with one more ``[[effect]]`` at its end, ``remarks`` above its values.

    Raises:
        RigError: the rig has this effect already.
    """
    document: Any = tomlkit.parse(text)
    if effect.label in dict(_owners(document)):
        raise RigError(f"the rig has the effect '{effect.label}' already")
    entry = tomlkit.table()
    for remark in remarks:
        entry.add(tomlkit.comment(remark))
    entry["name"], entry["where"] = effect.name, effect.where
    for part, quantity in effect.values.items():
        ratio = quantity.dimension == "ratio"
        key = part if ratio else f"{part}_{PLAIN[quantity.dimension]}"
        factor = 1.0 if ratio else UNITS[PLAIN[quantity.dimension]][1]
        entry[key] = _written(quantity, factor)
    if "effect" not in document:
        document["effect"] = tomlkit.aot()
    document["effect"].append(entry)
    return tomlkit.dumps(document)


def _written(quantity: Quantity, factor: float) -> Any:
    nominal = float(f"{quantity.nominal / factor:.{_DIGITS}g}")
    if quantity.uncertainty is None and not quantity.identify:
        return nominal
    table = tomlkit.inline_table()
    table["nominal"] = nominal
    if quantity.uncertainty is not None:
        table["uncertainty"] = float(f"{quantity.uncertainty / factor:.{_UNCERTAINTY_DIGITS}g}")
    if quantity.identify:
        table["identify"] = True
    return table


def _owners(document: Any) -> Iterator[tuple[str, Any]]:
    """Every table that has parameters, by its name."""
    mechanism = document["mechanism"]
    if "tip" in mechanism:
        yield "tip", mechanism["tip"]
    tables = [mechanism.get(kind, []) for kind in ("joint", "fixture", "base_point", "plate_point")]
    trackers = document.get("tracker", [])
    tables += [document.get("channel", []), trackers, *(t.get("marker", []) for t in trackers)]
    for table in tables:
        for entry in table:
            yield entry["name"], entry
    for entry in document.get("effect", []):
        yield f"{entry['name']}@{entry['where']}", entry


def _set(entry: Any, part: str, calibrated: Calibrated) -> None:
    fitting = [
        f"{part}_{unit}"
        for unit, (dimension, _) in UNITS.items()
        if dimension == calibrated.dimension
    ]
    if part in entry:
        key, factor = part, 1.0
    else:
        key = next((k for k in fitting if k in entry), f"{part}_{PLAIN[calibrated.dimension]}")
        factor = UNITS[key.removeprefix(f"{part}_")][1]
    nominal = float(f"{calibrated.value / factor:.{_DIGITS}g}")
    old = entry.get(key)
    if calibrated.standard_error is None and not isinstance(old, dict):
        entry[key] = nominal
        return
    new = old if isinstance(old, dict) else tomlkit.inline_table()
    new["nominal"] = nominal
    if calibrated.standard_error is not None and calibrated.standard_error > 0:
        new["uncertainty"] = float(f"{calibrated.standard_error / factor:.{_UNCERTAINTY_DIGITS}g}")
    entry[key] = new
