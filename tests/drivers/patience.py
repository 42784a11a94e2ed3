"""How long the tests wait for what another thread, process or the kernel does in a moment."""

from __future__ import annotations

PATIENCE_S = 60.0
"""Of real time: long enough for a computer that is busy, and it costs nothing where it is not."""
