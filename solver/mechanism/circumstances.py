"""Under what each pose was read, beside its readings: what effects beyond the mechanism depend on.

Owns the table and how it is cut. Where its columns come from is the business of
`solver.samples` (fixture, time, approach, rate) and `solver.mechanism.statics` (loads).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Circumstances of P poses, C channels; None where nobody knows.

    Attributes:
        fixture: (P,) which of the rig's fixtures held each pose; None where there is one at most.
        time_s: (P,) middle of the dwell since the session began [s]; of several sessions, that lie
            end to end on one axis, since the first one began.
        approach: (P, C) 1.0 where the channel last moved to larger values, -1.0 to smaller ones,
            0.0 where it did not move.
        rate: (P, C) speed of each channel's true value while it was read [rad/s or m/s].
        noise: (P, C) standard deviation of one sample [counts], as quantisation sees it.
        torque: (P, J) what the drive of each joint exerts on its link [Nm or N], or the tension
            of each leg [N], in the order of the mechanism's places.
        moment: (P, J, 2) what holds each turning joint exerts on its link about the two axes across
            the joint's own, those of its tilts [Nm]; 0 of a slide. None of a platform.
        force: (P, 3) what the mechanism exerts on its fixture [N], in the fixture's axes (the
            base frame's where the rig has no fixtures, or is a platform).
        begun_s: (P,) when the pose's own session began, on the axis of ``time_s`` [s]; None where
            there is but one.
    """

    fixture: NDArray[np.intp] | None = None
    time_s: Array | None = None
    approach: Array | None = None
    rate: Array | None = None
    noise: Array | None = None
    torque: Array | None = None
    moment: Array | None = None
    force: Array | None = None
    begun_s: Array | None = None

    @property
    def running_s(self) -> Array | None:
        """(P,) for how long each pose's own session had run [s]."""
        if self.time_s is None or self.begun_s is None:
            return self.time_s
        return np.asarray(self.time_s - self.begun_s)

    def take(self, poses: NDArray[np.intp] | NDArray[np.bool_]) -> Circumstances:
        """The circumstances of some poses."""
        known = {
            f.name: getattr(self, f.name)[poses]
            for f in fields(self)
            if getattr(self, f.name) is not None
        }
        return Circumstances(**known)

    def repeated(self, times: int) -> Circumstances:
        """The circumstances of all poses, ``times`` over."""
        known = {
            f.name: np.concatenate([getattr(self, f.name)] * times)
            for f in fields(self)
            if getattr(self, f.name) is not None
        }
        return Circumstances(**known)

    def loaded(
        self, torque: Array | None, force: Array | None, moment: Array | None
    ) -> Circumstances:
        """The same with loads."""
        return replace(self, torque=torque, force=force, moment=moment)
