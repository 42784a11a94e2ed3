"""What every method returns: parameters, their covariance, and how well the data determine them.

A result is data. That a fit did not converge, or that some directions cannot be identified,
is a status here and never an exception.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.correlation import Correlation
from solver.estimate.robust import DOWNWEIGHTED, Loss
from solver.estimate.trust_region import Status
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_SIGNIFICANT = 0.99  # of chi-square: a larger misfit is not noise


@dataclass(frozen=True)
class Estimate:
    """Parameters identified from P poses by one method.

    Attributes:
        method: name of the method.
        space: the parameters; ``space.names`` are the n identified ones.
        status: why the method stopped.
        iterations: steps it took.
        parameters: (N,) full parameter vector, SI.
        covariance: (n, n) of the identified parameters under reading noise alone, SI.
        jacobian: (M, n) of the method's residual, SI columns.
        residual: (M,) the method's residual at the solution.
        coordinates: (P, U) the poses' coordinates.
        freedoms: degrees of freedom of the misfit.
        misfit: residual sum of squares over what sensor noise alone would leave; 1 where the
            model and the noise explain everything (chi-square per degree of freedom).
        held: (n, k) orthonormal directions (in scaled parameters) that the data do not
            determine and that were held at their priors.
        left_out: poses that the method could not use.
        weights: (P,) of the poses under a robust loss, 1 otherwise; None where the method has none.
            ``residual`` and ``jacobian`` carry their roots.
        loss: that gave the weights.
        priors: whether the rig's stated uncertainties took part.
        correlation: what the residuals of neighbouring poses share; None where that was not
            looked at, or too little is left over to tell.
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
    freedoms: int
    misfit: float
    held: Array
    left_out: int = 0
    weights: Array | None = None
    loss: Loss = Loss.NONE
    priors: bool = False
    correlation: Correlation | None = None

    @property
    def values(self) -> Array:
        """(n,) identified values, SI."""
        return self.space.reduce(self.parameters)

    @property
    def downweighted(self) -> NDArray[np.intp]:
        """Indices of the poses that a robust loss weighs down so far that it is worth telling."""
        weights = np.ones(0) if self.weights is None else self.weights
        return np.flatnonzero(weights < DOWNWEIGHTED)

    @property
    def inflation(self) -> float:
        """Factor on all standard errors: the root of the misfit where that is significantly above 1.

        Then something is missing from the model, and noise alone would promise too much
        (the scale factor of the Particle Data Group's averages).
        """
        if self.freedoms < 1 or not np.isfinite(self.misfit):
            return 1.0
        from scipy.special import gammaincinv  # heavy to import: only where it is needed

        # A quantile of chi-squared of f freedoms is twice that of the gamma law of shape f / 2.
        limit = 2.0 * gammaincinv(self.freedoms / 2, _SIGNIFICANT) / self.freedoms
        return float(np.sqrt(self.misfit)) if self.misfit > limit else 1.0

    @property
    def spread(self) -> Array:
        """(n, n) covariance behind the standard errors, SI.

        That of reading noise, inflated where the misfit asks for it, and what errors that
        neighbouring poses share add where there are any (`correlation`).
        """
        spread = self.inflation**2 * self.covariance
        return spread if self.correlation is None else spread + self.correlation.widening

    @property
    def standard_errors(self) -> Array:
        """(n,) standard errors, SI: the roots of the diagonal of `spread`."""
        return np.asarray(np.sqrt(np.diag(self.spread)))
