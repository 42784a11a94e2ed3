"""What turns the bytes of a streaming sensor into samples: the narrow protocol of such a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from recordings.events import ReadingFlag


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample of all signals.

    Attributes:
        counts: raw counts by signal; None where the device sent no number.
        sequence: raw value of its sample counter, None where it has none.
        ticks: raw value of its clock, None where it has none.
        flags: what the device says about the sample.
    """

    counts: Mapping[str, int | None]
    sequence: int | None = None
    ticks: int | None = None
    flags: ReadingFlag = field(default=ReadingFlag.NONE)


class Decoder(Protocol):
    """Decodes a stream. Pure: knows no port and no clock."""

    def feed(self, data: bytes) -> Sequence[Sample | str]:
        """What ``data`` completes, in order: samples, and in words what made no sense."""
        ...

    def reset(self) -> None:
        """The stream begins anew, anywhere: forget what is incomplete."""
        ...
