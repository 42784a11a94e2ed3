"""Closure errors of a hinged arm as Giugovaz & Hollerbach report them, and what noise alone would leave.

Owns equations 14 and 15 as printed, (1/3N) sqrt(sum) and (1/2N) sqrt(sum), which shrink with
the number of poses for the same errors, and beside them the plain root mean square of a
component, sqrt(sum / 3N) and sqrt(sum / 2N).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate import hinge
from solver.estimate.nuisance import Observations
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClosureErrors:
    """Closure errors of P poses.

    Attributes:
        orientation: (P, 2) [rad], about x and y of the hinge frame.
        position: (P, 3) [m], hinge frame.
        position_predicted: root mean square [m] of a component that reading noise explains.
        orientation_predicted: likewise [rad].
    """

    orientation: Array
    position: Array
    position_predicted: float
    orientation_predicted: float

    @property
    def position_rms(self) -> float:
        """Root mean square of a position component [m]."""
        return float(np.sqrt(np.mean(self.position**2)))

    @property
    def orientation_rms(self) -> float:
        """Root mean square of an orientation component [rad]."""
        return float(np.sqrt(np.mean(self.orientation**2)))

    @property
    def sigma_position_as_printed(self) -> float:
        """Equation 14 as printed [m]."""
        return float(np.sqrt(np.sum(self.position**2)) / (3 * len(self.position)))

    @property
    def sigma_orientation_as_printed(self) -> float:
        """Equation 15 as printed [rad]."""
        return float(np.sqrt(np.sum(self.orientation**2)) / (2 * len(self.orientation)))


def closure_errors(
    model: SerialModel, space: ParameterSpace, observed: Observations, parameters: Array
) -> ClosureErrors:
    """Closure errors at ``parameters`` (N,) with the readings as measured."""
    closure = hinge.residual(model, observed.counts, parameters, space.expansion).closure
    spread = np.diagonal(closure.spread(observed.sigma), axis1=1, axis2=2)
    return ClosureErrors(
        orientation=closure.residual[:, :2],
        position=closure.residual[:, 2:],
        position_predicted=float(np.sqrt(np.mean(spread[:, 2:]))),
        orientation_predicted=float(np.sqrt(np.mean(spread[:, :2]))),
    )
