"""One thing that is to be said of a recording, how much it matters, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How much a finding matters."""

    BAD = "bad"
    """Something is lost or wrong that should not be."""
    CAUTION = "caution"
    """Known and accounted for, or only suspicious: look before you rely on it."""
    NOTE = "note"
    """Worth knowing."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing about a recording.

    Attributes:
        severity: how much it matters.
        kind: its name, for programs.
        text: what was found.
        remedy: what to do, or "" where nothing is to be done.
    """

    severity: Severity
    kind: str
    text: str
    remedy: str = ""
