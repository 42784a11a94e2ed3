"""When something may have changed at once: between any two neighbouring dwells of a recording."""

from __future__ import annotations

import numpy as np

from solver.mechanism.circumstances import Circumstances

_ON_EITHER_SIDE = 3  # poses: what fewer show is an outlier, not a change


def moments(at: Circumstances) -> tuple[float, ...]:
    """Times [s] midway between neighbouring dwells, with some poses on either side."""
    if at.time_s is None:
        return ()
    times = np.unique(at.time_s)
    middles = 0.5 * (times[1:] + times[:-1])
    return tuple(
        float(t)
        for t in middles
        if min(np.sum(at.time_s < t), np.sum(at.time_s >= t)) >= _ON_EITHER_SIDE
    )


def no_moment(at: Circumstances) -> str | None:
    """Why no such moment can be looked for, in words; None where one can."""
    if at.time_s is None:
        return "nobody knows when the poses were read"
    if not moments(at):
        return f"there are not {_ON_EITHER_SIDE} poses both before and after any moment"
    return None
