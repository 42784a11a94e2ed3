"""External trackers as they really are: where the markers on the moving end are seen.

A marker at m on an end turned by q and shifted by p is at p + q m in the base frame; a
tracker that stands at c with its axes turned by r sees it at r* (p + q m - c).

Owns geometry only: noise and counts are the sensor's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from recordings.rig import Rig, Tracker
from sim_devices.plant.quaternion import IDENTITY, Array, about, turn

_OPPOSITE = np.array([1.0, -1.0, -1.0, -1.0])


class Trackers:
    """All trackers of a rig.

    Args:
        rig: as described.
        values: true parameters, SI, by name.
    """

    def __init__(self, rig: Rig, values: Mapping[str, float]) -> None:
        self._stands = [_stand(tracker, values) for tracker in rig.trackers]
        self._markers = [
            np.array([[values[f"{m.name}.{axis}"] for axis in "xyz"] for m in tracker.markers])
            for tracker in rig.trackers
        ]

    def seen(self, turned: Array, shifted: Array) -> Array:
        """(n, 3M) coordinates of all markers [m], in the order of the rig's places.

        Args:
            turned: (n, 4) turn of the end in the base frame.
            shifted: (n, 3) its origin [m].
        """
        columns = [np.empty((len(turned), 0))]
        for (origin, axes_turn), markers in zip(self._stands, self._markers, strict=True):
            at = turn(turned[:, None], markers) + shifted[:, None] - origin
            columns.append(turn(axes_turn * _OPPOSITE, at).reshape(len(turned), -1))
        return np.hstack(columns)


def _stand(tracker: Tracker, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Origin (3,) [m] and turn (4,) of a tracker's frame in the base frame."""
    origin = np.array([values[f"{tracker.name}.{axis}"] for axis in "xyz"])
    vector = np.array([values[f"{tracker.name}.r{axis}"] for axis in "xyz"])
    angle = float(np.linalg.norm(vector))
    return origin, about(vector / angle, np.array(angle)) if angle > 0 else IDENTITY
