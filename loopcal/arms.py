"""Files of arms that are described and measured elsewhere: URDFs in and out, tables of poses."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from loopcal.console import fail
from loopcal.files import create
from recordings.rig.quantity import UNITS
from recordings.tables import Table
from recordings.urdf import Doubts, calibrated_urdf, rig_from_urdf


def write_rig(
    urdf: Path,
    tip: str,
    constraint: str,
    fixtures: Sequence[str],
    doubts: Doubts,
    output: Path,
    *,
    gravity_compensated: bool,
) -> None:
    """Write the rig for the chain of ``urdf`` that ends in ``tip``; never over another file."""
    text = rig_from_urdf(
        _read(urdf),
        tip,
        constraint,
        fixtures=fixtures,
        doubts=doubts,
        gravity_compensated=gravity_compensated,
    )
    create(output, text)


def write_calibrated(result: Path, urdf: Path, tip: str, output: Path) -> None:
    """Write ``urdf`` with the origins that a result file estimates."""
    try:
        document: Any = json.loads(_read(result))
        values = {
            str(p["name"]): float(p["value"]) * UNITS[p["unit"].replace("/", "_per_")][1]
            for p in document["parameters"]
        }
    except (ValueError, KeyError, TypeError, AttributeError):
        fail(f"'{result}' is not a result file; `loopcal solve FILE --json RESULT.json` writes one")
    create(output, calibrated_urdf(_read(urdf), tip, values))


def table_of(item: str) -> Table:
    """``TABLE.csv`` or ``FIXTURE=TABLE.csv``; a file whose own name has an equals sign is a file."""
    fixture, equals, path = item.partition("=")
    if not equals or Path(item).exists():
        return Table(Path(item))
    return Table(Path(path), fixture)


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        fail(f"cannot read '{path}': {error}")
