"""Maximum likelihood with errors in every reading: the solver's own method, for both families.

Minimises over parameters x, and over every pose's true coordinates u, the whitened reading
residuals, subject to loop closure; `nuisance` eliminates u. Reaches the Cramér-Rao bound for
small noise, and needs no choice between metres and radians: noise is the only scale.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.estimate.closing import approach
from solver.estimate.estimate import Estimate
from solver.estimate.identifiability import covariance
from solver.estimate.nuisance import Observations, Settled, assemble, settle
from solver.estimate.trust_region import Evaluation, Status, minimise
from solver.mechanism.model import Model
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

NAME = "ml"


def identify(
    model: Model,
    space: ParameterSpace,
    observed: Observations,
    *,
    use_priors: bool = False,
    start: Array | None = None,
    iterations: int = 100,
) -> Estimate:
    """Parameters by maximum likelihood.

    Args:
        model: the mechanism.
        space: what is identified.
        observed: averaged readings of P poses, with their standard deviations.
        use_priors: add the rig's stated uncertainties of the identified parameters as
            Gaussian priors around the nominal values.
        start: (N,) starting parameters; nominal by default.
        iterations: trust-region steps at most.
    """
    begin = space.nominal if start is None else start
    prior = space.reduce(space.nominal), space.uncertainty
    believed = np.isfinite(prior[1]) if use_priors else np.zeros(len(space.names), dtype=bool)
    if isinstance(model, SerialModel):
        begin, first = approach(model, space, observed, begin)
    else:
        first = assemble(model, observed, begin)
    closures = model.linearise(first[:1], begin, space.expansion).closure.shape[1]
    freedoms = first.shape[1] - closures

    def evaluate(
        z: Array, state: tuple[Array, Settled] | None
    ) -> Evaluation[tuple[Array, Settled]] | None:
        if state is None:
            coordinates = first
        else:
            coordinates = state[1].coordinates + state[1].following @ (z - state[0])
        found = settle(model, observed, coordinates, space.expand(z, begin), space.expansion)
        if not found.closed.all():
            return None
        residual, jacobian = found.residual.ravel(), found.jacobian.reshape(-1, len(z))
        if believed.any():
            width = prior[1][believed]
            residual = np.concatenate([residual, (z - prior[0])[believed] / width])
            jacobian = np.vstack([jacobian, np.eye(len(z))[believed] / width[:, None]])
        return Evaluation(residual, jacobian, (z, found))

    z0 = space.reduce(begin)
    minimum = minimise(evaluate, z0, iterations=iterations)
    if minimum is None:
        found = settle(model, observed, first, begin, space.expansion)
        flat = found.jacobian.reshape(-1, len(z0))
        return _estimate(
            space, begin, Status.DOES_NOT_CLOSE, 0, found, found.residual.ravel(), flat, freedoms
        )
    settled = minimum.last.state[1]
    return _estimate(
        space,
        space.expand(minimum.variables, begin),
        minimum.status,
        minimum.iterations,
        settled,
        minimum.last.residual,
        minimum.last.jacobian,
        freedoms,
    )


def _estimate(
    space: ParameterSpace,
    parameters: Array,
    status: Status,
    iterations: int,
    settled: Settled,
    residual: Array,
    jacobian: Array,
    freedoms: int,
) -> Estimate:
    cov, found = covariance(space, jacobian)
    poses, channels = settled.residual.shape
    priors = len(residual) - poses * channels
    free = poses * (channels - freedoms) - found.rank + priors
    return Estimate(
        method=NAME,
        space=space,
        status=status,
        iterations=iterations,
        parameters=parameters,
        covariance=cov,
        jacobian=jacobian,
        residual=residual,
        coordinates=settled.coordinates,
        freedoms=free,
        misfit=float(residual @ residual) / free if free > 0 else float("nan"),
        held=found.held,
    )
