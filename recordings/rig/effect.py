"""Effects beyond the plain mechanism: what a gap analysis found, or a user knows, to be at work.

An effect has a name, a place, and values whose keys carry their units as everywhere in a rig
file. Which values each effect has, and what they mean, is told in `docs/formats.md`; whoever
computes with an effect (the solver, the simulated plant) checks that it knows it.

Owns how an entry is read. Refuses to know any effect by name: users add their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from recordings.rig.quantity import UNITS, Quantity, fail, read_quantity

_RESERVED = ("name", "where")


@dataclass(frozen=True, slots=True)
class DescribedEffect:
    """One ``[[effect]]`` of a rig file.

    Attributes:
        name: which effect, ``nonlinearity``.
        where: what it sits at, in the rig's own names: a channel, a joint, ``q6<-q7``.
        values: its coefficients and settings by name, SI. A plain number has the dimension "ratio".
    """

    name: str
    where: str
    values: Mapping[str, Quantity]

    @property
    def label(self) -> str:
        """``name@where``, as parameters are called: ``nonlinearity@q6.p2``."""
        return f"{self.name}@{self.where}"

    @classmethod
    def read(cls, table: Any) -> DescribedEffect:
        """The effect of a TOML table; raises a validation error that says what is wrong."""
        if isinstance(table, cls):
            return table
        if not isinstance(table, dict):
            raise fail(f"found {table!r:.80}, expected a table")
        for key in _RESERVED:
            if not isinstance(table.get(key), str) or not table[key]:
                raise fail(f"'{key}' is {table.get(key)!r}, expected a text")
        values: dict[str, Quantity] = {}
        for key, value in table.items():
            if key in _RESERVED:
                continue
            part, unit = _split(key)
            if part in values:
                raise fail(f"'{key}' says what another key says already; keep one of them")
            values[part] = read_quantity(key, value, unit)
        return cls(table["name"], table["where"], values)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(cls.read)


def _split(key: str) -> tuple[str, str]:
    """Name and unit suffix of a key; the longest suffix that is a unit counts."""
    for start in range(1, len(key)):
        if key[start] == "_" and key[start + 1 :] in UNITS:
            return key[:start], key[start + 1 :]
    return key, "1"
