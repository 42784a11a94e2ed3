"""A stop of a session: when the mechanism sets out, arrives, rests and leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

LEAD_S = 0.5
"""Time that a session watches the mechanism before it first moves [s]."""

FOLLOWING_ERROR = 0x8611
"""CiA 402: the joint does not follow its drive."""
REFERENCE_LIMIT = 0x8612
"""CiA 402: the target lies beyond the joint's limits."""


@dataclass(frozen=True, slots=True)
class Stop:
    """One visit of a pose.

    Attributes:
        pose: number of the pose.
        visit: 0 at its first visit.
        start_s: sets out.
        arrive_s: stands.
        rest_s: has settled, the dwell begins.
        leave_s: the dwell ends.
        targets: by driven joint, the counts that its sensor shall read.
        faults: by driven joint, CiA 402 error code of a drive that did not get there.
        fixture: that holds the endpoint, or None where the rig has none.
    """

    pose: int
    visit: int
    start_s: float
    arrive_s: float
    rest_s: float
    leave_s: float
    targets: Mapping[str, int] = field(default_factory=dict)
    faults: Mapping[str, int] = field(default_factory=dict)
    fixture: str | None = None
