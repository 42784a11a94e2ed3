"""`loopcal bench-calibrate`: a table of known displacements in, gain, zero, linearity and noise out.

Owns the table's columns and where the figures go in a rig file, whose comments and order stay
as they are.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import tomlkit
import tomlkit.exceptions
from rich.table import Table

from loopcal.console import fail, out
from loopcal.files import create
from recordings.rig import Channel, parse_rig, rig_text
from solver.bench_calibration import BenchCalibration, Figure, bench_calibration

_COLUMNS = {
    "displacement_mm": ("length", 1e-3, "mm"),
    "displacement_m": ("length", 1.0, "m"),
    "angle_deg": ("angle", math.pi / 180.0, "deg"),
    "angle_rad": ("angle", 1.0, "rad"),
}
"""Displacement columns that a table may have: dimension, factor to SI, unit shown."""
_FACTORS = {"m": 1.0, "mm": 1e-3, "rad": 1.0, "deg": math.pi / 180.0}


def run_bench_calibrate(rig: str, channel: str, table: Path, output: Path | None) -> None:
    """Calibrate ``channel`` from ``table``, print it, and write the rig with it to ``output``."""
    text, source = rig_text(rig)
    description = parse_rig(text, source)
    names = [c.name for c in description.channels]
    if channel not in names:
        fail(f"rig '{description.name}' has no channel '{channel}'; channels: {', '.join(names)}")
    told = description.channel(channel)
    dimension, factor, unit, displacement, counts = read_bench_table(table)
    wanted = description.dimension_of(told.senses)
    if dimension != wanted:
        fail(
            f"'{table}' holds displacements of dimension {dimension}, but channel '{channel}' senses {wanted}"
        )
    found = bench_calibration([factor * x for x in displacement], counts)
    _show(found, channel, factor, unit)
    if output is not None:
        written = calibrated_rig(text, told, found)
        parse_rig(written, f"the calibrated {source}")
        create(output, written)
        out.print(f"wrote {output}", markup=False)


def read_bench_table(path: Path) -> tuple[str, float, str, list[float], list[float]]:
    """Dimension, factor to SI and unit of the displacements; displacements; counts."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True)
            columns = [name.strip() for name in table.fieldnames or ()]
            table.fieldnames = columns
            given = [name for name in _COLUMNS if name in columns]
            if len(given) != 1 or "counts" not in columns:
                fail(
                    f"'{path}' has the columns {', '.join(columns) or '(none)'}; expected 'counts' "
                    f"and one of: {', '.join(_COLUMNS)}"
                )
            displacement: list[float] = []
            counts: list[float] = []
            for row in table:
                for cell, into in ((row[given[0]], displacement), (row["counts"], counts)):
                    try:
                        into.append(float(cell))
                    except (TypeError, ValueError):
                        fail(f"'{path}', line {table.line_num}: {cell!r} is not a number")
    except (OSError, UnicodeDecodeError) as error:
        fail(f"cannot read the table '{path}': {error}")
    return *_COLUMNS[given[0]], displacement, counts


def calibrated_rig(text: str, channel: Channel, found: BenchCalibration) -> str:
    """The rig file ``text`` with the figures of one channel in it, comments kept.

    ``gain`` and its uncertainty, ``zero_count`` (the nearest count to displacement 0) and
    ``noise_counts`` are replaced. An ``offset`` that the channel has stays the value of the same
    counts as before; where it has none, it becomes the value of the fraction of a count that
    ``zero_count`` leaves.
    """
    document: Any = tomlkit.parse(text)
    entry = next(item for item in document["channel"] if item["name"] == channel.name)
    if channel.gain.tie is not None:
        fail(
            f"the gain of channel '{channel.name}' is tied to {channel.gain.tie.parameter}; calibrate that one"
        )
    zero = round(found.zero.value)
    key, factor = _key(entry, "gain")
    _set(entry, key, found.gain.value / factor, found.gain.standard_error / factor)
    linearity = found.linearity.value
    entry[key].comment(f"bench: linearity {linearity:.2g} % of full scale")
    if channel.offset.tie is None:
        if any(name.startswith("offset_") for name in entry):
            key, factor = _key(entry, "offset")
            moved = found.gain.value * (zero - channel.zero_count)
            _set(entry, key, (channel.offset.nominal + moved) / factor, None)
        else:
            unit = key.removeprefix("gain_").removesuffix("_per_count")
            value = found.gain.value * (zero - found.zero.value) / _FACTORS[unit]
            error = abs(found.gain.value) * found.zero.standard_error / _FACTORS[unit]
            _set(entry, f"offset_{unit}", value, error)
    entry["zero_count"] = zero
    entry["noise_counts"] = _rounded(found.noise.value)
    return tomlkit.dumps(document)


def _key(entry: Any, name: str) -> tuple[str, float]:
    """The key under which ``entry`` gives a quantity, and its unit's factor to SI."""
    key = next(key for key in entry if key.startswith(f"{name}_"))
    return key, _FACTORS[key.removeprefix(f"{name}_").removesuffix("_per_count")]


def _set(entry: Any, key: str, value: float, error: float | None) -> None:
    """Put a number under ``key``; what else is said of it stays."""
    old = entry.get(key)
    new = old if isinstance(old, dict) else tomlkit.inline_table()
    new["nominal"] = _rounded(value, 9)
    if error is not None:
        new["uncertainty"] = _rounded(error)
    plain = len(new) == 1 and not isinstance(old, dict)
    entry[key] = new["nominal"] if plain else new


def _rounded(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")


def _show(found: BenchCalibration, channel: str, factor: float, unit: str) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column in (channel, "value", "± SE", "unit"):
        table.add_column(column, justify="left" if column in (channel, "unit") else "right")
    gain = Figure(found.gain.value / factor, found.gain.standard_error / factor)
    for name, figure, shown in (
        ("gain", gain, f"{unit}/count"),
        ("zero", found.zero, "counts"),
        ("linearity", found.linearity, "% of full scale"),
        ("noise", found.noise, "counts"),
    ):
        table.add_row(name, f"{figure.value:.6g}", f"{figure.standard_error:.2g}", shown)
    out.print(table)
    out.print(
        f"{int(found.readings.sum())} readings at {len(found.stations)} displacements; "
        f"full scale {found.full_scale:.6g} counts",
        markup=False,
    )
    if not found.repeated:
        out.print("no displacement was read twice: noise includes what is not straight")
    if found.inflation > 1.0:
        out.print(
            f"the stations leave the line by more than noise: standard errors of gain and zero are {found.inflation:.3g} times larger"
        )
