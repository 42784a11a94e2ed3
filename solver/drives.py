"""Which joints a drive held at each dwell, as the session recorded it: what loads depend on.

A joint is held where its drive last reported position mode before the dwell's end (of a drive that
never reports, where it was last commanded to). A joint without a drive is free. Where a session
records no modes at all, the drives of its plan are believed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.events import Mode, ModeCommand, ModeReport
from recordings.reader import Recording
from solver.dwells import Window


def held_joints(recording: Recording, windows: Sequence[Window]) -> NDArray[np.bool_] | None:
    """(P, J) whether a drive held each place of the mechanism at ``windows``; None where nobody said."""
    places = recording.rig.mechanism.places
    said: dict[str, list[ModeReport | ModeCommand]] = {}
    events: tuple[ModeReport | ModeCommand, ...] = (
        *recording.mode_reports,
        *recording.mode_commands,
    )
    for event in events:
        said.setdefault(event.joint, []).append(event)
    out = np.zeros((len(windows), len(places)), dtype=bool)
    if not said:
        plan = recording.rig.plan
        if plan is None or not plan.drives:
            return None
        out[:, [places.index(name) for name in plan.drives]] = True
        return out
    ends = np.array([window.end_ns for window in windows], dtype=np.int64)
    for joint, told in said.items():
        reports = [event for event in told if isinstance(event, ModeReport)]
        ordered = sorted(reports or told, key=lambda event: event.time_ns)
        times = np.array([event.time_ns for event in ordered], dtype=np.int64)
        holds = np.array([False, *(event.mode is Mode.POSITION for event in ordered)])
        if joint in places:
            out[:, places.index(joint)] = holds[np.searchsorted(times, ends, side="right")]
    return out
