"""When something may have changed at once: between any two neighbouring dwells of a recording."""

from __future__ import annotations

import numpy as np

from solver.mechanism.circumstances import Circumstances

_ON_EITHER_SIDE = 3  # poses: what fewer show is an outlier, not a change
_LOOKED_AT = 100  # moments, of as many as there are: a change is seen from its neighbours too


def looked_at(at: Circumstances) -> tuple[float, ...]:
    """Some of `moments`, evenly spread, where there are many; all where there are few."""
    every = moments(at)
    if len(every) <= _LOOKED_AT:
        return every
    return tuple(every[i] for i in np.linspace(0, len(every) - 1, _LOOKED_AT).round().astype(int))


def between(moment_s: float, at: Circumstances) -> tuple[float, ...]:
    """Those of `moments` that lie between the neighbours of ``moment_s`` in `looked_at`."""
    some, every = looked_at(at), moments(at)
    if len(some) == len(every):
        return ()
    before = max((t for t in some if t < moment_s), default=-np.inf)
    after = min((t for t in some if t > moment_s), default=np.inf)
    return tuple(t for t in every if before < t < after)


def moments(at: Circumstances) -> tuple[float, ...]:
    """Times [s] midway between neighbouring dwells, with some poses on either side."""
    if at.time_s is None:
        return ()
    times = np.unique(at.time_s)
    middles = 0.5 * (times[1:] + times[:-1])
    before = np.searchsorted(np.sort(at.time_s), middles)
    inside = np.minimum(before, len(at.time_s) - before) >= _ON_EITHER_SIDE
    return tuple(middles[inside].tolist())


def no_moment(at: Circumstances) -> str | None:
    """Why no such moment can be looked for, in words; None where one can."""
    if at.time_s is None:
        return "nobody knows when the poses were read"
    if not moments(at):
        return f"there are not {_ON_EITHER_SIDE} poses both before and after any moment"
    return None
