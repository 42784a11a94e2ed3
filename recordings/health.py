"""What is to be thought of a recording: findings in words, each with what to do about it.

Pure: it looks at a survey only. Moments are told in seconds since the recording's first message.
"""

from __future__ import annotations

from recordings import completeness, plausibility
from recordings.finding import Finding, Severity
from recordings.survey import Survey

CHECKS = (
    completeness.files,
    completeness.rig,
    completeness.gone,
    completeness.ledger,
    plausibility.time,
    plausibility.silences,
    plausibility.values,
    plausibility.session,
)


def findings(found: Survey) -> tuple[Finding, ...]:
    """All that is to be said of a recording, what matters most first."""
    every = [finding for check in CHECKS for finding in check(found)]
    order = list(Severity)
    return tuple(sorted(every, key=lambda finding: order.index(finding.severity)))


__all__ = ["Finding", "Severity", "findings"]
