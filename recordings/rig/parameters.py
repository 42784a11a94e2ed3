"""Every number of a rig that a calibration could estimate, as one ordered table.

Owns the names (``joint3.s``, ``q1.offset``, ``A2.x``), the units in which results show
them, and the ties between them. The solver's columns, nature's truth and the keys of
result files all come from here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from recordings.rig.mechanism import POSE, SerialMechanism
from recordings.rig.quantity import SHOWN, Quantity, Tie

if TYPE_CHECKING:
    from recordings.rig.rig import Rig


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of the model.

    Attributes:
        name: ``<joint>.<a|s|alpha|theta_offset>``, ``<channel>.<offset|gain>``,
            ``<point|marker>.<x|y|z>``, ``<tracker>.<x|y|z|rx|ry|rz>`` or ``<effect>@<where>.<value>``.
        dimension: "length", "angle", "length/count" or "angle/count"; effects have others too.
        nominal: value before calibration, SI (rad, m, rad/count, m/count); ties resolved.
        uncertainty: standard uncertainty of the nominal value, SI, or None.
        identify: whether the rig asks for it to be estimated.
        tie: set when it only follows another parameter.
    """

    name: str
    dimension: str
    nominal: float
    uncertainty: float | None
    identify: bool
    tie: Tie | None

    @property
    def unit(self) -> str:
        """Unit in which results show it."""
        return SHOWN[self.dimension][0]

    @property
    def to_si(self) -> float:
        """Factor from the shown unit to SI."""
        return SHOWN[self.dimension][1]


def quantities(rig: Rig) -> Iterator[tuple[str, Quantity, str]]:
    """Name, value and dimension of each parameter, in the order of the table."""
    if isinstance(rig.mechanism, SerialMechanism):
        for joint in rig.mechanism.joints:
            for part in joint.parts:
                quantity: Quantity = getattr(joint, part)
                yield f"{joint.name}.{part}", quantity, quantity.dimension
        poses = [(fixture.name, fixture) for fixture in rig.mechanism.fixtures]
        for name, pose in [("tip", rig.mechanism.tip), *poses]:
            for part in POSE if pose is not None else ():
                quantity = getattr(pose, part)
                yield f"{name}.{part}", quantity, quantity.dimension
    else:
        for point in (*rig.mechanism.base_points, *rig.mechanism.plate_points):
            for axis in ("x", "y", "z"):
                quantity = getattr(point, axis)
                yield f"{point.name}.{axis}", quantity, quantity.dimension
    for channel in rig.channels:
        dimension = rig.dimension_of(channel.senses)
        yield f"{channel.name}.offset", channel.offset, dimension
        yield f"{channel.name}.gain", channel.gain, f"{dimension}/count"
    for tracker in rig.trackers:
        for part in ("x", "y", "z", "rx", "ry", "rz"):
            quantity = getattr(tracker, part)
            yield f"{tracker.name}.{part}", quantity, quantity.dimension
        for marker in tracker.markers:
            for axis in ("x", "y", "z"):
                quantity = getattr(marker, axis)
                yield f"{marker.name}.{axis}", quantity, quantity.dimension
    for effect in rig.effects:
        for part, quantity in effect.values.items():
            yield f"{effect.label}.{part}", quantity, quantity.dimension


def parameters(rig: Rig) -> tuple[Parameter, ...]:
    """The parameter table of ``rig``: mechanism, channels, trackers, effects, in file order."""
    given = {name: quantity for name, quantity, _ in quantities(rig)}

    def nominal(quantity: Quantity) -> float:
        # Rig validation guarantees that a tie leads to an untied parameter.
        return (
            quantity.nominal
            if quantity.tie is None
            else quantity.tie.factor * given[quantity.tie.parameter].nominal
        )

    return tuple(
        Parameter(
            name,
            dimension,
            nominal(quantity),
            quantity.uncertainty,
            quantity.identify,
            quantity.tie,
        )
        for name, quantity, dimension in quantities(rig)
    )
