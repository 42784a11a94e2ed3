"""What every method returns: parameters, their covariance, and how well the data determine them.

A result is data. That a fit did not converge, or that some directions cannot be identified,
is a status here and never an exception.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.trust_region import Status
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """Parameters identified from P poses by one method.

    Attributes:
        method: name of the method.
        space: the parameters; ``space.names`` are the n identified ones.
        status: why the method stopped.
        iterations: steps it took.
        parameters: (N,) full parameter vector, SI.
        covariance: (n, n) of the identified parameters, SI.
        jacobian: (M, n) of the method's residual, SI columns.
        residual: (M,) the method's residual at the solution.
        coordinates: (P, U) the poses' coordinates.
        misfit: residual sum of squares over what sensor noise alone would leave; 1 where the
            model and the noise explain everything (chi-square per degree of freedom).
        held: (n, k) orthonormal directions (in scaled parameters) that the data do not
            determine and that were held at their priors.
        left_out: poses that the method could not use.
    """

    method: str
    space: ParameterSpace
    status: Status
    iterations: int
    parameters: Array
    covariance: Array
    jacobian: Array
    residual: Array
    coordinates: Array
    misfit: float
    held: Array
    left_out: int = 0

    @property
    def values(self) -> Array:
        """(n,) identified values, SI."""
        return self.space.reduce(self.parameters)

    @property
    def standard_errors(self) -> Array:
        """(n,) standard errors, SI."""
        return np.sqrt(np.diag(self.covariance))
