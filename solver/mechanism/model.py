"""What the estimators know of a mechanism: readings h(u, x), loop closure c(u, x), and their derivatives.

u are each pose's true coordinates, x the full parameter vector. One interface serves both
families, so that one estimator does. Owns the seam and the choice of family.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, SerialMechanism, parameters

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
        fixture: NDArray[np.intp] | None = None,
    ) -> Linearised:
        """Predictions and derivatives.

        Args:
            coordinates: (P, U).
            parameters: (N,).
            directions: (N, n), the directions in parameter space to differentiate along.
            fixture: (P,) which of the rig's fixtures each pose was held in; by default the first.
        """
        ...

    def pseudo_observations(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """What is known beside readings and nominal values: whitened residuals (D,) and (D, n) derivatives."""
        ...

    def end_pose(self, coordinates: Array, parameters: Array, directions: Array) -> EndPose:
        """Endpoint or plate at ``coordinates`` (P, U), with derivatives as `linearise` gives them."""
        ...

    def starts(self, readings: Array, parameters: Array) -> Array:
        """(S, P, U) starting coordinates, best guess first, for measured ``readings`` (P, C) [counts]."""
        ...

    def mobility(self, coordinates: Array, parameters: Array) -> int:
        """Freedoms of the closed mechanism at a generic pose."""
        ...


def model_of(rig: Rig) -> Model:
    """The model of ``rig``'s mechanism and channels; raises MechanismError."""
    from solver.mechanism.platform import PlatformModel
    from solver.mechanism.serial import SerialModel
    from solver.mechanism.tracker import Tracked, without_trackers

    table, inside = parameters(rig), without_trackers(rig)
    serial = isinstance(rig.mechanism, SerialMechanism)
    inner = SerialModel.of(inside, table) if serial else PlatformModel.of(inside, table)
    return Tracked.of(rig, inner, table) if rig.trackers else inner
