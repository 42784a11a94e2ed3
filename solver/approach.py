"""From which side each channel came to rest: what backlash depends on.

Owns the reading of directions from raw counts. A channel that noise alone moved between two
dwells keeps the side that it had: slack stays where it was left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from solver.dwells import Track, Window

Array = NDArray[np.float64]

_MOVED = 8.0  # standard deviations of one sample
_LEAST = 1.5  # counts: below this, rounding alone


def approaches(
    tracks: Mapping[str, Track], windows: Sequence[Window], noise: Array
) -> NDArray[np.float64]:
    """Sides (P, C) of P dwells.

    Args:
        tracks: readings by channel, C of them, as counts that do not wrap.
        windows: the dwells, in order of time.
        noise: (C,) standard deviation of one sample [counts].

    Returns:
        1.0 where the counts last rose to the dwell's level, -1.0 where they fell to it, 0.0
        before the first motion.
    """
    sides = np.zeros((len(windows), len(tracks)))
    starts = np.array([w.start_ns for w in windows])
    ends = np.array([w.end_ns for w in windows])
    for c, track in enumerate(tracks.values()):
        begin = np.searchsorted(track.time_ns, starts)
        end = np.searchsorted(track.time_ns, ends, side="right")
        still = max(_MOVED * float(noise[c]), _LEAST)
        before, side = 0, 0.0
        for w in range(len(windows)):
            dwell = track.counts[begin[w] : end[w]]
            path = track.counts[before : begin[w]]
            if len(dwell):
                away = path - dwell.mean()
                last = np.flatnonzero(np.abs(away) > still)
                if len(last):
                    side = -float(np.sign(away[last[-1]]))
            sides[w, c] = side
            before = end[w]
    return sides
