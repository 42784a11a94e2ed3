"""What the estimators know of a mechanism: readings h(u, x), loop closure c(u, x), and their derivatives.

u are each pose's true coordinates, x the full parameter vector. One interface serves both
families, so that one estimator does. Owns the seam and the choice of family.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Parameter, Rig, SerialMechanism, parameters
from solver.mechanism.circumstances import Circumstances

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Linearised:
    """A model and its first derivatives at P poses.

    C channels, K closure rows, U coordinates, n directions in parameter space.

    Attributes:
        readings: (P, C) [counts], predicted.
        closure: (P, K) [m, rad], zero where the loop closes; K may be 0.
        readings_by_coordinates: (P, C, U).
        readings_by_parameters: (P, C, n).
        closure_by_coordinates: (P, K, U).
        closure_by_parameters: (P, K, n).
    """

    readings: Array
    closure: Array
    readings_by_coordinates: Array
    readings_by_parameters: Array
    closure_by_coordinates: Array
    closure_by_parameters: Array


@dataclass(frozen=True, slots=True)
class EndPose:
    """Where the arm's endpoint or the plate is, in the base frame, at P poses.

    Attributes:
        rotation: (P, 3, 3), base from end.
        position: (P, 3) [m].
        by_coordinates: (P, 6, U), rates of [dp; domega] in the base frame.
        by_parameters: (P, 6, n), likewise along n directions in parameter space.
    """

    rotation: Array
    position: Array
    by_coordinates: Array
    by_parameters: Array


class Model(Protocol):
    """A mechanism with its sensors."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel names, in the order of readings."""
        ...

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of a pose's coordinates."""
        ...

    def linearise(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> Linearised:
        """Predictions and derivatives.

        Args:
            coordinates: (P, U).
            parameters: (N,), or (P, N) where geometry differs from pose to pose.
            directions: (N, n), the directions in parameter space to differentiate along.
            at: the circumstances of the poses; by default all in the first fixture.
        """
        ...

    def pseudo_observations(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """What is known beside readings and nominal values: whitened residuals (D,) and (D, n) derivatives."""
        ...

    def end_pose(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> EndPose:
        """Endpoint or plate at ``coordinates`` (P, U), with derivatives as `linearise` gives them.

        Circumstances matter where effects move the geometry.
        """
        ...

    def starts(self, readings: Array, parameters: Array) -> Array:
        """(S, P, U) starting coordinates, best guess first, for measured ``readings`` (P, C) [counts]."""
        ...

    def mobility(self, coordinates: Array, parameters: Array) -> int:
        """Freedoms of the closed mechanism at a generic pose."""
        ...


def model_of(rig: Rig) -> Model:
    """The model of ``rig``'s mechanism, channels and effects; raises MechanismError."""
    if not rig.effects:
        return mechanism_model(rig, parameters(rig))
    from solver.effects.grown import grown_model

    return grown_model(rig)


def mechanism_model(rig: Rig, table: tuple[Parameter, ...], *, imperfect: bool = False) -> Model:
    """The model of ``rig``'s mechanism and straight sensors, whatever effects it describes.

    Args:
        rig: as described.
        table: its parameters.
        imperfect: whether parameter vectors go on, behind ``table``, with `imperfections`.

    Raises:
        MechanismError: a mechanism that no model fits.
    """
    from solver.mechanism.platform import PlatformModel
    from solver.mechanism.serial import SerialModel
    from solver.mechanism.tracker import Tracked, without_trackers

    inside = without_trackers(rig)
    serial = isinstance(rig.mechanism, SerialMechanism)
    inner = (
        SerialModel.of(inside, table, imperfect=imperfect)
        if serial
        else PlatformModel.of(inside, table, imperfect=imperfect)
    )
    return Tracked.of(rig, inner, table) if rig.trackers else inner


TILTS = ("tilt_1", "tilt_2")
"""Of a turning joint; where it turns about x, y, z they are about y and z, z and x, x and y."""


def imperfections(rig: Rig) -> tuple[str, ...]:
    """Names of what is zero in every rig description, and what only effects move.

    ``mount.x`` ... ``mount.rz``: displacement of the fixture, in its own frame, in the order of
    the transform Tx Ty Tz Rz Ry Rx; of a rig without fixtures, displacement of all that lies
    before its base frame, in the base frame; of a platform, of its plate (``x``, ``y``, ``z``).
    ``joint1.tilt_1``, ``joint1.tilt_2`` ...: tilt of a turning joint about the two axes across its own,
    `TILTS`, in the frame before it turns.
    ``leg1.base.x``, ``leg1.plate.x`` ...: displacement of one leg's end from the point it shares.
    """
    if isinstance(rig.mechanism, SerialMechanism):
        mount = (f"mount.{part}" for part in ("x", "y", "z", "rx", "ry", "rz"))
        turning = (joint.name for joint in rig.mechanism.joints if joint.type == "revolute")
        return (*mount, *(f"{name}.{tilt}" for name in turning for tilt in TILTS))
    ends = tuple(
        f"{leg.name}.{end}.{axis}"
        for leg in rig.mechanism.legs
        for end in ("base", "plate")
        for axis in "xyz"
    )
    return ("mount.x", "mount.y", "mount.z", *ends)
