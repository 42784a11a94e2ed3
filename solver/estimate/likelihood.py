"""Maximum likelihood with errors in every reading: the solver's own method, for both families.

Minimises over parameters x, and over every pose's true coordinates u, the whitened reading
residuals, subject to loop closure; `nuisance` eliminates u. Reaches the Cramér-Rao bound for
small noise, and needs no choice between metres and radians: noise is the only scale. A robust
loss is minimised by settling the weights in the linear model about a fit, and refitting; the
covariance is then the inverse of the weighted information, for Huber's loss within 2 % of its
asymptotic variance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from solver.effects.grown import Grown
from solver.estimate.closing import approach
from solver.estimate.correlation import correlation
from solver.estimate.estimate import Estimate
from solver.estimate.holding import minimise_held
from solver.estimate.identifiability import covariance
from solver.estimate.locating import located
from solver.estimate.nuisance import Observations, Settled, assemble, settle
from solver.estimate.robust import Loss, reweighted
from solver.estimate.trust_region import Evaluation, Minimum, Status
from solver.mechanism.model import Model
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

NAME = "ml"

_REWEIGHTINGS = 10
_SETTLED_WEIGHT = 1e-3


def identify(
    model: Model,
    space: ParameterSpace,
    observed: Observations,
    *,
    loss: Loss = Loss.NONE,
    use_priors: bool = False,
    start: Array | None = None,
    iterations: int = 100,
) -> Estimate:
    """Parameters by maximum likelihood.

    Args:
        model: the mechanism.
        space: what is identified.
        observed: averaged readings of P poses, with their standard deviations.
        loss: how much poses that noise cannot explain count (`robust`).
        use_priors: add the rig's stated uncertainties of the identified parameters as
            Gaussian priors around the nominal values.
        start: (N,) starting parameters; nominal by default.
        iterations: trust-region steps at most.
    """
    begin = located(model, space, observed, space.nominal if start is None else start)
    prior = space.reduce(space.nominal), space.uncertainty
    believed = np.isfinite(prior[1]) if use_priors else np.zeros(len(space.names), dtype=bool)
    if isinstance(model, SerialModel):
        begin, first = approach(model, space, observed, begin, use_priors=use_priors)
    elif isinstance(model, Grown):
        begin, first = _without_effects(model, space, observed, begin, use_priors)
    else:
        first = assemble(model, observed, begin)
    closures = model.linearise(first[:1], begin, space.expansion).closure.shape[1]
    freedoms = first.shape[1] - closures

    def fit(z0: Array, nearby: Array, weight: Array) -> Minimum[tuple[Array, Settled]] | None:
        """The minimum near reduced parameters ``z0``, poses near ``nearby`` (P, U) weighing ``weight``."""
        root = np.sqrt(weight)[:, None]

        def evaluate(
            z: Array, state: tuple[Array, Settled] | None
        ) -> Evaluation[tuple[Array, Settled]] | None:
            if state is None:
                coordinates = nearby
            else:
                coordinates = state[1].coordinates + state[1].following @ (z - state[0])
            full = space.expand(z, begin)
            found = settle(model, observed, coordinates, full, space.expansion)
            if not found.closed.all():
                return None
            known, by_parameters = model.pseudo_observations(full, space.expansion)
            weighted = (found.jacobian * root[:, :, None]).reshape(-1, len(z))
            residual = np.concatenate([(found.residual * root).ravel(), known])
            jacobian = np.vstack([weighted, by_parameters])
            if believed.any():
                width = prior[1][believed]
                residual = np.concatenate([residual, (z - prior[0])[believed] / width])
                jacobian = np.vstack([jacobian, np.eye(len(z))[believed] / width[:, None]])
            return Evaluation(residual, jacobian, (z, found))

        return minimise_held(evaluate, z0, space, iterations=iterations)

    z0 = space.reduce(begin)
    weight = np.ones(len(first))
    minimum = fit(z0, first, weight)
    if minimum is None:
        found = settle(model, observed, first, begin, space.expansion)
        flat = found.jacobian.reshape(-1, len(z0))
        return _estimate(
            space,
            begin,
            Minimum(
                z0, Evaluation(found.residual.ravel(), flat, (z0, found)), Status.DOES_NOT_CLOSE, 0
            ),
            freedoms,
            weight,
            loss=loss,
            priors=use_priors,
            judged=None,
        )
    usual = None
    for _ in range(_REWEIGHTINGS if loss is not Loss.NONE else 0):
        settled = minimum.last.state[1]
        redundancy = settled.residual.shape[1] - freedoms
        beside = (
            minimum.last.residual[settled.residual.size :],
            minimum.last.jacobian[settled.residual.size :],
        )
        renewed, usual = reweighted(
            loss, settled.residual, settled.jacobian, beside, weight, redundancy, usual
        )
        if np.abs(renewed - weight).max() < _SETTLED_WEIGHT:
            break
        again = fit(minimum.variables, settled.coordinates, renewed)
        if again is None:
            break
        steps = minimum.iterations + again.iterations
        minimum, weight = replace(again, iterations=steps), renewed
    parameters = space.expand(minimum.variables, begin)
    return _estimate(
        space,
        parameters,
        minimum,
        freedoms,
        weight,
        loss=loss,
        priors=use_priors,
        judged=(model, observed),
    )


def _without_effects(
    model: Grown, space: ParameterSpace, observed: Observations, begin: Array, use_priors: bool
) -> tuple[Array, Array]:
    """Parameters (N,) and coordinates (P, U) to start from: an arm's as if there were no effects."""
    plain, some = model.without_effects(space)
    if isinstance(plain, SerialModel) and some.names:
        near = begin[: model.named]
        near, first = approach(plain, some, observed, near, use_priors=use_priors)
        return np.concatenate([near, begin[model.named :]]), first
    return begin, assemble(model, observed, begin)


def _estimate(
    space: ParameterSpace,
    parameters: Array,
    minimum: Minimum[tuple[Array, Settled]],
    freedoms: int,
    weight: Array,
    *,
    loss: Loss,
    priors: bool,
    judged: tuple[Model, Observations] | None,
) -> Estimate:
    residual, jacobian = minimum.last.residual, minimum.last.jacobian
    settled = minimum.last.state[1]
    cov, found = covariance(space, jacobian)
    poses, channels = settled.residual.shape
    pseudo = len(residual) - poses * channels
    free = poses * (channels - freedoms) - found.rank + pseudo
    expected = free * loss.expected(channels - freedoms)
    misfit = float(residual @ residual) / expected if free > 0 else float("nan")
    alike = None
    if judged is not None:
        root = np.sqrt(weight)[:, None]
        weighted = replace(
            settled, residual=settled.residual * root, jacobian=settled.jacobian * root[:, :, None]
        )
        alike = correlation(*judged, weighted, parameters, cov)
    return Estimate(
        method=NAME,
        space=space,
        status=minimum.status,
        iterations=minimum.iterations,
        parameters=parameters,
        covariance=cov,
        jacobian=jacobian,
        residual=residual,
        coordinates=settled.coordinates,
        freedoms=free,
        misfit=misfit,
        held=found.held,
        weights=weight,
        loss=loss,
        priors=priors,
        correlation=alike,
    )
