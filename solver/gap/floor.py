"""The noise floor: what poses that were visited again say about noise, and whether the fit reaches it.

Readings of one pose at several visits share whatever the model gets wrong about that pose,
so their spread is pure error: noise within the dwell, and whatever differs from visit to
visit. Lack of fit is an F test of the fit's excess over it. Without revisits the noise within
dwells stands in, and the verdict is provisional.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from solver.dwells import Window
from solver.gap.fit import Fit

Array = NDArray[np.float64]

_ENOUGH = 5  # poses visited again, of which a floor can be told
_NEAR = 0.03  # of a channel's travel: poses set by hand that differ less count as one


@dataclass(frozen=True)
class Floor:
    """Pure error and lack of fit of one fit.

    Attributes:
        variance: of the noise, in units of the assumed one, from the visits; 1 where there are none.
        freedoms: degrees of freedom of that.
        revisited: poses with more than one visit.
        ratio: F of the lack of fit; mean square of the misfit where there are no revisits.
        p: its p-value.
    """

    variance: float
    freedoms: int
    revisited: int
    ratio: float
    p: float

    @property
    def provisional(self) -> bool:
        """Whether there is little but the noise within dwells to go by."""
        return self.revisited < _ENOUGH


def same_poses(windows: Sequence[Window], counts: Array) -> NDArray[np.intp]:
    """(P,) number of the pose that each dwell visited.

    By the poses' numbers where the recording repeats them; else dwells whose readings differ by
    little of each channel's travel count as one pose.
    """
    first: dict[tuple[int, str | None], int] = {}
    named = [first.setdefault((w.pose, w.fixture), len(first)) for w in windows]
    if len(first) < len(windows):
        return np.array(named, dtype=np.intp)
    travel = np.maximum(np.ptp(counts, axis=0), 1e-12)
    scaled = counts / travel
    group = np.full(len(counts), -1, dtype=np.intp)
    count = 0
    for i in range(len(counts)):
        if group[i] < 0:
            near = (np.abs(scaled - scaled[i]).max(axis=1) < _NEAR) & (group < 0)
            group[near] = count
            count += 1
    return group


def floor(fit: Fit, poses: NDArray[np.intp]) -> Floor:
    """The floor of ``fit``, whose dwells visited ``poses`` (P,)."""
    r = fit.residual
    count = np.bincount(poses)
    means = np.stack(
        [np.bincount(poses, weights=column) / np.maximum(count, 1) for column in r.T], axis=1
    )
    pure = float(np.sum((r - means[poses]) ** 2))
    free = int(len(r) - np.count_nonzero(count)) * fit.redundancy
    rest = fit.freedoms - free
    if free == 0:
        ratio = fit.rss / max(fit.freedoms, 1)
        return Floor(1.0, 0, 0, ratio, float(chdtrc(max(fit.freedoms, 1), fit.rss)))
    # Noise from visit to visit comes on top of that within dwells, which is well known.
    variance = max(pure / free, 1.0)
    if rest <= 0:
        return Floor(variance, free, int(np.sum(count > 1)), 1.0, 1.0)
    ratio = max(fit.rss - pure, 0.0) / rest / variance
    return Floor(variance, free, int(np.sum(count > 1)), ratio, float(fdtrc(rest, free, ratio)))
