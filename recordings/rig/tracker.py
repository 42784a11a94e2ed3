"""External trackers: an instrument beside the mechanism that measures where markers on its end are.

A tracker has a frame of its own, which stands anywhere; a marker sits on the endpoint of a
serial mechanism, or on the plate of a platform, at an offset that need not be known. Each
coordinate of a marker is a place that a channel can sense: ``<marker>.x``, ``.y``, ``.z``,
in the tracker's frame.
"""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from recordings.rig.quantity import ANGLE, LENGTH, Described, Quantity

AXES = ("x", "y", "z")


class Marker(Described):
    """One marker: its offset from the endpoint, in the frame of the endpoint or plate."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(AXES, LENGTH)

    name: str
    x: Quantity
    y: Quantity
    z: Quantity


class Tracker(Described):
    """One tracker: where its frame stands in the base frame, and the markers that it sees.

    x, y, z is the origin of the tracker's frame; rx, ry, rz is the rotation vector (axis
    times angle) that turns the base frame's axes into the tracker's.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        **dict.fromkeys(AXES, LENGTH),
        "rx": ANGLE,
        "ry": ANGLE,
        "rz": ANGLE,
    }

    name: str
    x: Quantity = Quantity(dimension="length")
    y: Quantity = Quantity(dimension="length")
    z: Quantity = Quantity(dimension="length")
    rx: Quantity = Quantity(dimension="angle")
    ry: Quantity = Quantity(dimension="angle")
    rz: Quantity = Quantity(dimension="angle")
    markers: tuple[Marker, ...] = Field(alias="marker", min_length=1)

    @property
    def places(self) -> tuple[str, ...]:
        """What a channel of this tracker can sense."""
        return tuple(f"{marker.name}.{axis}" for marker in self.markers for axis in AXES)
