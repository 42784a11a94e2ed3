"""Waiting for an answer, on a host that may be held up itself.

A host does not always run: its processor is busy, its memory is swapped out, its virtual machine
is paused. What a device answered meanwhile is there, and must be read before the device is called
silent. So a wait is made of short ones, each of which counts as what it was meant to last, however
long it did; and after one that lasted far too long comes a last look.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

LONGEST_WAIT_S = 0.05
"""Longest wait in one turn of a link: how soon another thread gets its turn."""

HELD_UP_S = 0.02
"""By how much a wait may be late without a last look."""


def waits(timeout_s: float, longest_s: float = LONGEST_WAIT_S) -> Iterator[float]:
    """How long to wait [s], again and again, until ``timeout_s`` have been waited; at least once."""
    left_s = timeout_s
    while True:
        wait_s = min(left_s, longest_s)
        began_s = time.monotonic()
        yield wait_s
        passed_s = time.monotonic() - began_s
        left_s -= min(passed_s, wait_s)
        if left_s <= 0:
            break
    if passed_s > wait_s + HELD_UP_S:
        yield 0.0
