"""Tables of poses into recordings: one row a pose, one column a channel.

Owns the column names and their units. A value is turned into the counts that its channel
would give at the rig's nominal gain and offset, because a recording holds counts. Each row
becomes one reading of every channel within one dwell; when the rows were measured is not
known, so that they follow each other by a second from a fixed moment.

Refuses columns that are neither a channel's nor known, rows with gaps, and values that no
count can hold.
"""

from __future__ import annotations

import csv
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from recordings.errors import TableError
from recordings.events import Dwell, Mark, Reading
from recordings.rig import Channel, Rig, SerialMechanism
from recordings.rig.quantity import UNITS
from recordings.session import Session
from recordings.writer import Writer

EPOCH_NS = 1_735_689_600_000_000_000
"""Time of the first row: 2025-01-01T00:00:00 UTC."""

_SECOND = 1_000_000_000
_DWELL_NS = 500_000_000
_ASIDE = ("fixture", "pose", "visit", "direction")
_SUFFIXES = ("rad", "deg", "m", "mm", "counts")
_MOST = 2**53
_MOST_POSES = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Table:
    """A CSV file of poses.

    Attributes:
        path: the file.
        fixture: in which fixture all of its poses were taken, where it has no column that says so.
    """

    path: Path
    fixture: str | None = None


def import_tables(
    rig: Rig,
    rig_toml: str,
    tables: Sequence[Table],
    path: str | Path,
    *,
    columns: Sequence[str] | None = None,
) -> int:
    """Write a recording of all rows of ``tables``; returns how many there were.

    Args:
        rig: as described.
        rig_toml: its text, which the recording carries.
        tables: in order.
        path: file to create.
        columns: names of the columns of tables that have no header line.

    A column is ``<channel>_<unit>`` with the unit rad, deg, m, mm or counts, or one of: fixture;
    pose and visit (numbers from 0; the n-th row of a visit is pose n where no column says);
    direction (from where the pose was approached), which is kept as a mark. A table without a
    fixture of its own is of the fixture that its file is named after, or of the rig's only one.

    Raises:
        TableError: a table cannot be read or does not fit the rig; says where.
        RecordingError: the recording exists already or cannot be written.
    """
    rows = [row for table in tables for row in _rows(rig, table, columns)]
    if not rows:
        raise TableError("the tables have no rows")
    session = Session(
        session_id=str(uuid.uuid5(uuid.NAMESPACE_OID, rig_toml + repr(rows))),
        start_ns=EPOCH_NS,
        notes="imported from " + ", ".join(table.path.name for table in tables),
    )
    seen: dict[int, int] = {}
    with Writer(path, rig_toml, session) as writer:
        for number, row in enumerate(rows):
            begin = EPOCH_NS + number * _SECOND
            for name, raw in row.counts.items():
                writer.write(Reading(name, begin + _DWELL_NS // 2, raw))
            pose = seen.get(row.visit, 0) if row.pose is None else row.pose
            seen[row.visit] = seen.get(row.visit, 0) + 1
            end = begin + _DWELL_NS
            writer.write(Dwell(end, begin, end, pose, row.visit, row.fixture))
            if row.direction:
                writer.write(
                    Mark(end, f"pose {pose}, visit {row.visit}: direction {row.direction}")
                )
        for channel in rig.channels:
            writer.account(channel.name, expected=len(rows))
    return len(rows)


@dataclass(frozen=True, slots=True)
class _Row:
    """One pose: counts by channel, and what the columns beside them say."""

    counts: Mapping[str, int]
    fixture: str | None
    pose: int | None
    visit: int
    direction: str


def _rows(rig: Rig, table: Table, columns: Sequence[str] | None) -> Iterator[_Row]:
    known = rig.mechanism.fixture_names if isinstance(rig.mechanism, SerialMechanism) else ()
    default = table.fixture
    if default is None and len(known) == 1:
        default = known[0]
    if default is None and table.path.stem in known:
        default = table.path.stem
    try:
        with table.path.open(newline="", encoding="utf-8-sig") as file:
            lines = [(n, row) for n, row in enumerate(csv.reader(file), 1) if any(row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TableError(f"cannot read the table '{table.path}': {error}") from error
    if columns is None:
        if not lines:
            raise TableError(f"the table '{table.path}' is empty, expected a line of column names")
        header = [name.strip() for name in lines.pop(0)[1]]
    else:
        header = list(columns)
    meaning = _meaning(rig, table, header)
    for number, cells in lines:
        where = f"line {number} of '{table.path}'"
        if len(cells) != len(header):
            raise TableError(f"{where} has {len(cells)} columns, expected {len(header)}: {header}")
        row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
        fixture = row.get("fixture") or default
        if known and fixture not in known:
            said = "no fixture" if fixture is None else f"the fixture '{fixture}'"
            raise TableError(
                f"{where} is of {said}, expected one of: {', '.join(known)}. Add a column 'fixture', "
                "name the file after its fixture, or give it as FIXTURE=FILE"
            )
        yield _Row(
            {
                channel.name: _counts(channel, unit, row[name], where)
                for name, (channel, unit) in meaning.items()
            },
            fixture,
            _number(row["pose"], "pose", where) if "pose" in row else None,
            _number(row.get("visit", "0"), "visit", where),
            row.get("direction", ""),
        )


def _meaning(rig: Rig, table: Table, header: Sequence[str]) -> dict[str, tuple[Channel, str]]:
    """Channel and unit of each column that holds readings."""
    units = {
        "angle": ("rad", "deg", "counts"),
        "length": ("m", "mm", "counts"),
    }
    out: dict[str, tuple[Channel, str]] = {}
    names = [channel.name for channel in rig.channels]
    for column in header:
        name, _, unit = column.rpartition("_")
        if column in _ASIDE:
            continue
        if name not in names or unit not in _SUFFIXES:
            raise TableError(
                f"'{table.path}' has the column '{column}', expected <channel>_<unit> with a channel out of "
                f"{', '.join(names)} and a unit out of {', '.join(_SUFFIXES)}, or one of {', '.join(_ASIDE)}. "
                "For a table without column names, give them with --columns"
            )
        channel = rig.channel(name)
        allowed = units[rig.dimension_of(channel.senses)]
        if unit not in allowed:
            raise TableError(
                f"column '{column}' of '{table.path}' is in {unit}, but {name} senses {channel.senses}: "
                f"expected {', '.join(allowed)}"
            )
        out[column] = channel, unit
    given = [channel.name for channel, _ in out.values()]
    for name in names:
        if given.count(name) != 1:
            raise TableError(
                f"'{table.path}' has {given.count(name)} columns of channel '{name}', expected one of each channel"
            )
    return out


def _counts(channel: Channel, unit: str, text: str, where: str) -> int:
    try:
        value = float(text)
    except ValueError as error:
        raise TableError(f"{where} has '{text}' for {channel.name}, expected a number") from error
    if unit != "counts":
        offset = channel.offset.nominal
        value = channel.zero_count + (value * UNITS[unit][1] - offset) / channel.gain.nominal
    if not abs(value) <= _MOST:
        raise TableError(
            f"{where} has {text} {unit} for {channel.name}, which is {value:.3g} counts: beyond what counts hold"
        )
    return round(value)


def _number(text: str, what: str, where: str) -> int:
    if not (text.isdecimal() and len(text) <= len(str(_MOST_POSES)) and int(text) <= _MOST_POSES):
        raise TableError(
            f"{where} has '{text[:40]}' for {what}, expected a whole number from 0 to {_MOST_POSES}"
        )
    return int(text)
