"""Parts: one recording in several files, and what each file says of its neighbours.

The first part has the name that was asked for, `run.mcap`; `run.002.mcap` and so on lie beside
it. Each is a recording of its own, with the rig, the session and the ledger so far.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

PART_METADATA = "loopcal.part"
"""Metadata record at the beginning of every part but the first."""

NEXT_METADATA = "loopcal.next"
"""Metadata record at the end of every part but the last."""

_BEFORE = "received_before/"


@dataclass(frozen=True, slots=True)
class Part:
    """Which part of a recording a file is.

    Attributes:
        number: from 1.
        previous_file: name of the part before, or "" in the first.
        next_file: name of the part behind, or "" where the file knows of none.
        received_before: readings of each channel in the parts before; none for the first.
    """

    number: int = 1
    previous_file: str = ""
    next_file: str = ""
    received_before: Mapping[str, int] = field(default_factory=dict)

    def with_metadata(self, name: str, pairs: Mapping[str, str]) -> Part:
        """This, and what the metadata record ``name`` says; itself where that says nothing.

        Raises:
            ValueError: a number is none.
        """
        if name == NEXT_METADATA:
            return replace(self, next_file=pairs.get("file", ""))
        if name == PART_METADATA:
            return replace(
                self,
                number=int(pairs["part"]) if "part" in pairs else 1,
                previous_file=pairs.get("previous", ""),
                received_before={
                    key.removeprefix(_BEFORE): int(value)
                    for key, value in pairs.items()
                    if key.startswith(_BEFORE)
                },
            )
        return self


FIRST_PART = Part()
"""What a file is that says nothing of parts."""


def beginning(part: Part) -> dict[str, str]:
    """The metadata with which ``part`` begins."""
    before = {f"{_BEFORE}{channel}": str(n) for channel, n in part.received_before.items()}
    return {"part": str(part.number), "previous": part.previous_file, **before}


def ending(number: int, file: str) -> dict[str, str]:
    """The metadata with which a part ends: that part ``number`` is in ``file``."""
    return {"part": str(number), "file": file}


def one_byte_off(found: str, expected: str) -> bool:
    """Whether a text differs from the expected one as a single damaged byte makes it differ."""
    pairs = list(zip(found, expected, strict=False))
    return len(found) == len(expected) and sum(a != b for a, b in pairs) == 1


def belongs(
    part: Part, found_session_id: str, *, number: int, session_id: str, previous_file: str
) -> str:
    """Why a file is not the part that was looked for, or "" where it is.

    One damaged byte in what it says of itself does not make a stranger of it.

    Args:
        part: what the file says of itself.
        found_session_id: the session it says it is of.
        number, session_id: of the part looked for.
        previous_file: name of the part before it.
    """
    same_session = found_session_id == session_id or one_byte_off(found_session_id, session_id)
    if same_session and (part.number == number or part.previous_file == previous_file):
        return ""
    return (
        f"is part {part.number} of session '{found_session_id}', expected part {number} of "
        f"session '{session_id}'"
    )


def part_path(first: Path, number: int) -> Path:
    """Where part ``number`` of the recording that begins in ``first`` lies."""
    return first if number == 1 else first.with_name(f"{first.stem}.{number:03d}{first.suffix}")


def old_parts(first: Path) -> list[Path]:
    """Files that have the name of a later part of the recording that begins in ``first``."""
    pattern = re.compile(rf"{re.escape(first.stem)}\.\d+{re.escape(first.suffix)}")
    return sorted(path for path in first.parent.glob("*") if pattern.fullmatch(path.name))
