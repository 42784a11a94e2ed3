"""How patient a session is, and how much it holds in memory."""

from __future__ import annotations

from dataclasses import dataclass, field

from recordings.storage import Storage, Sync


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """Limits of one session; the defaults suit a bench.

    Attributes:
        live_timeout_s: how long every channel may take to deliver its first reading.
        mode_timeout_s: how long a drive may take to report a commanded mode.
        still_timeout_s: how long the mechanism may take to arrive at a stop and to stand
            still there, before the stop is skipped with a fault.
        skipped_stops: stops skipped in a row after which the session fails.
        max_duration_s: end the session after this time, or None for no limit.
        queue_capacity: readings that may wait for the disk before the newest are dropped.
        storage: how the recording is kept on disk: forced there at every flush, unless told.
    """

    live_timeout_s: float = 3.0
    mode_timeout_s: float = 3.0
    still_timeout_s: float = 10.0
    skipped_stops: int = 3
    max_duration_s: float | None = None
    queue_capacity: int = 200_000
    storage: Storage = field(default_factory=lambda: Storage(sync=Sync.FLUSH))
