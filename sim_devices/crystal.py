"""The crystal that a virtual device counts time by: a little fast or slow, as real ones are."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

LARGEST_ERROR = 50e-6
"""What makers promise of ordinary crystals over their temperature range."""


@dataclass(frozen=True, slots=True)
class Crystal:
    """A crystal that runs ``error`` faster than it should (0 is perfect)."""

    error: float = 0.0

    def elapsed(self, time_s: float) -> float:
        """What it counts in ``time_s`` of true time [s]."""
        return time_s * (1.0 + self.error)


PERFECT = Crystal()


def crystal_of(device: str) -> Crystal:
    """The crystal of the device called ``device``: always the same for the same name."""
    share = zlib.crc32(device.encode()) / 0xFFFF_FFFF
    return Crystal(LARGEST_ERROR * (2.0 * share - 1.0))
