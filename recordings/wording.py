"""How findings say numbers, names and moments."""

from __future__ import annotations

from collections.abc import Sequence

from recordings.survey import Survey

SECOND = 1_000_000_000
_MOST_NAMES = 8


def counted(count: int, what: str) -> str:
    """ "1 place", "2 places"."""
    return f"{count} {what}" + ("" if count == 1 else "s")


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def moment(found: Survey, time_ns: int) -> str:
    """A time, in seconds since the recording's first message."""
    return f"{(time_ns - found.start_ns) / SECOND:.1f} s"


def between(found: Survey, after_ns: int | None, before_ns: int | None) -> str:
    """A stretch of time; None at an end of the recording."""
    if after_ns is None and before_ns is None:
        return "all"
    if after_ns is None:
        return f"before {moment(found, before_ns or 0)}"
    if before_ns is None:
        return f"after {moment(found, after_ns)}"
    return f"{moment(found, after_ns)} to {moment(found, before_ns)}"
