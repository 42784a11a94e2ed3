"""Who recorded what, when and with what: the session's own metadata in a recording.

Owns the metadata record `loopcal.session`. All of it is for people and for the record;
a solve needs none of it, so a recording without it is read as an empty session.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version

METADATA_NAME = "loopcal.session"
"""Name of the MCAP metadata record that holds the session."""

SOFTWARE = f"loopcal {version('loopcal')}"
"""This program and its version."""


@dataclass(frozen=True, slots=True)
class Session:
    """One session of capture, import or simulation.

    Attributes:
        session_id: unique name of the session.
        start_ns: host time at its start, nanoseconds since the Unix epoch.
        operator: who ran it.
        notes: free text.
        host: name of the computer.
        software: program and version that recorded it.
    """

    session_id: str = ""
    start_ns: int = 0
    operator: str = ""
    notes: str = ""
    host: str = ""
    software: str = SOFTWARE


def to_metadata(session: Session) -> dict[str, str]:
    """``session`` as the key-value pairs of its metadata record."""
    # start_utc repeats start_time_ns for people who look into the file with other tools.
    seconds, nanoseconds = divmod(session.start_ns, 1_000_000_000)
    moment = datetime.fromtimestamp(seconds, UTC)
    return {
        "session_id": session.session_id,
        "start_time_ns": str(session.start_ns),
        "start_utc": f"{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z",
        "operator": session.operator,
        "notes": session.notes,
        "host": session.host,
        "software": session.software,
    }


def readable(pairs: Mapping[str, str]) -> dict[str, str]:
    """What can be read of damaged ``pairs``."""
    try:
        from_metadata(pairs)
    except ValueError:
        return {key: value for key, value in pairs.items() if key != "start_time_ns"}
    return dict(pairs)


def from_metadata(pairs: Mapping[str, str]) -> Session:
    """The session that ``pairs`` describe; what they do not say is empty.

    Raises:
        ValueError: ``start_time_ns`` is not an integer.
    """
    return Session(
        session_id=pairs.get("session_id", ""),
        start_ns=int(pairs.get("start_time_ns", "0")),
        operator=pairs.get("operator", ""),
        notes=pairs.get("notes", ""),
        host=pairs.get("host", ""),
        software=pairs.get("software", ""),
    )
