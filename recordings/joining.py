"""The parts of one recording, read together.

Owns which files belong to a recording that was given by its first part, and how what was
read from them becomes one. What is missing of a part, or a whole part, is damage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recordings.errors import RecordingsError
from recordings.part import FIRST_PART, belongs, part_path
from recordings.recording import Readings, Recording

_EVENTS = (
    "dwells",
    "marks",
    "faults",
    "mode_commands",
    "mode_reports",
    "clock",
    "states",
    "round_trips",
)


def joined(first: Recording, read: Callable[[Path], Recording]) -> Recording:
    """``first`` with all parts that follow it; itself where none does, or where it is not the first.

    Args:
        first: as read from its file alone.
        read: reads one file alone.
    """
    if first.part.number != 1 or not first.part.next_file:
        return first
    parts = [first]
    damage = list(first.damage)
    while parts[-1].part.next_file:
        number = len(parts) + 1
        path = next_path(first.path, number, parts[-1].part.next_file)
        try:
            found = read(path)
        except RecordingsError as error:
            damage.append(f"part {number} and what may follow it is missing: {error}")
            break
        stranger = belongs(
            found.part,
            found.session.session_id,
            number=number,
            session_id=first.session.session_id,
            previous_file=parts[-1].path.name,
        )
        if stranger:
            damage.append(f"part {number} and what may follow it is missing: '{path}' {stranger}")
            break
        damage += [f"{path.name}, {line}" for line in found.damage]
        parts.append(found)
    return _one(parts, tuple(damage))


def next_path(first: Path, number: int, stated: str) -> Path:
    """Where part ``number`` is: under the stated name, or where all parts were renamed alike."""
    beside = first.with_name(Path(stated).name)
    renamed = part_path(first, number)
    return renamed if renamed.exists() and not beside.exists() else beside


def _one(parts: Sequence[Recording], damage: tuple[str, ...]) -> Recording:
    first = parts[0]
    events: dict[str, Any] = {name: _events(parts, name) for name in _EVENTS}
    return replace(
        first,
        readings={
            name: _readings([part.readings[name] for part in parts]) for name in first.readings
        },
        ledger={source: entry for part in parts for source, entry in part.ledger.items()},
        damage=damage,
        part=FIRST_PART,
        **events,
    )


def _events(parts: Sequence[Recording], name: str) -> tuple[Any, ...]:
    return tuple(event for part in parts for event in getattr(part, name))


def _readings(parts: Sequence[Readings]) -> Readings:
    """One channel's readings of all parts; what a part lacks that has readings, the whole lacks."""
    parts = [part for part in parts if len(part)] or [parts[0]]
    if len(parts) == 1:
        return parts[0]
    time_ns = np.concatenate([part.time_ns for part in parts])
    order = (
        slice(None) if np.all(time_ns[1:] >= time_ns[:-1]) else np.argsort(time_ns, kind="stable")
    )
    columns: dict[str, Any] = {}
    for name in ("time_ns", "raw", "device_time_ns", "sequence", "flags"):
        pieces = [getattr(part, name) for part in parts]
        if any(piece is None for piece in pieces):
            columns[name] = None
            continue
        columns[name] = np.concatenate(pieces)[order]
        columns[name].flags.writeable = False
    return Readings(channel=parts[0].channel, **columns)
