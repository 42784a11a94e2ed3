"""A rig with some effects, fitted to all poses: what every step of a gap analysis starts from.

Owns the maximum-likelihood refit from a known starting point, with every pose's coordinates
eliminated, and directions that the data do not determine held at their priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from solver.effects.effect import Effect, Site
from solver.effects.grown import Grown, grow
from solver.estimate.holding import minimise_held
from solver.estimate.identifiability import covariance
from solver.estimate.nuisance import Observations, Settled, settle
from solver.estimate.trust_region import Evaluation
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_MOST_TAKEN = 0.9  # share of a dwell's residual that a fit is said to have taken up
_ITERATIONS = 40
_WORTHLESS = 1e2  # times the usual standard deviation: such a reading takes no part


@dataclass(frozen=True)
class Fit:
    """P poses, C channels, n identified parameters of which the last are the effects' coefficients.

    Attributes:
        effects: at work in the model.
        model: with them.
        space: its parameters.
        observed: the poses.
        parameters: (N + k,) at the optimum, SI.
        settled: the poses there.
        known: (D,) whitened residual of what is known beside readings.
        jacobian: (P C + D, n) of readings and of what is known, whitened.
        covariance: (n, n) for unit noise.
        rank: of the jacobian.
        redundancy: equations that a pose contributes beyond its coordinates.
        priors: whether the rig's stated uncertainties are among what is known.
    """

    effects: tuple[Effect, ...]
    model: Grown
    space: ParameterSpace
    observed: Observations
    parameters: Array
    settled: Settled
    known: Array
    jacobian: Array
    covariance: Array
    rank: int
    redundancy: int
    priors: bool

    @property
    def residual(self) -> Array:
        """(P, C) whitened measured - predicted."""
        return self.settled.residual

    @property
    def rss(self) -> float:
        """Sum of squares of all residuals."""
        return self.settled.cost + float(self.known @ self.known)

    @property
    def freedoms(self) -> int:
        """Degrees of freedom of `rss`."""
        sigma = self.observed.sigma
        worthless = int(np.sum(sigma > _WORTHLESS * np.median(sigma, axis=0)))
        return len(self.residual) * self.redundancy - worthless + len(self.known) - self.rank

    @property
    def at(self) -> Circumstances:
        """The poses' circumstances."""
        return self.observed.at or Circumstances()

    @cached_property
    def values(self) -> Array:
        """(P, C) true values of the channels' places [rad or m]."""
        return self.model.values(self.settled.coordinates, self.parameters, self.observed.at)

    @property
    def stacked(self) -> Array:
        """(M,) all residuals: of readings, then of what is known beside them, M = P C + D."""
        return np.concatenate([self.residual.ravel(), self.known])

    def projected(self, columns: Array) -> Array:
        """(M, m) what parameters cannot absorb of ``columns``, (P C, m) of readings alone or (M, m)."""
        beside = np.zeros((len(self.jacobian) - len(columns), columns.shape[1]))
        whole = np.vstack([columns, beside])
        return np.asarray(whole - self.absorbed @ (self.absorbed.T @ whole))

    def drawn(self, draws: int, rng: np.random.Generator) -> Array:
        """(M, draws) residuals with signs at random, one for each dwell, and what parameters leave of them.

        Residuals grow by 1 / sqrt(1 - h) first, h the share of a dwell's that the fit has taken up
        (Davidson & Flachaire, "The wild bootstrap, tamed at last", J. Econometrics 146, 2008): a
        dwell far out has pulled the fit towards itself, and spread what it was off over the others.
        """
        signs = rng.choice([-1.0, 1.0], size=(len(self.residual), draws))
        taken = self.absorbed[: self.residual.size].reshape(len(self.residual), -1)
        share = np.sum(taken**2, axis=1) / max(self.redundancy, 1)
        whole = self.residual / np.sqrt(1.0 - np.minimum(share, _MOST_TAKEN))[:, None]
        readings = (whole[:, :, None] * signs[:, None, :]).reshape(-1, draws)
        beside = self.known[:, None] * rng.choice([-1.0, 1.0], size=(len(self.known), draws))
        return self.projected(np.vstack([readings, beside]))

    @cached_property
    def absorbed(self) -> Array:
        """(M, r) orthonormal basis of what the parameters can absorb of all residuals."""
        left, singular, _ = np.linalg.svd(
            self.jacobian / _norms(self.jacobian), full_matrices=False
        )
        kept: Array = left[:, singular > 1e-7 * singular[:1].sum()]
        return kept

    def coefficients(self, effect: int) -> Array:
        """(k,) of one of the effects, SI."""
        return self.parameters[self.model.columns[effect]]

    def standard_errors(self, effect: int, scale: float) -> Array:
        """(k,) of its coefficients, SI, where noise is ``scale`` times the assumed one."""
        full = np.zeros(len(self.parameters))
        full[self.space.identified] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.asarray(scale * full[self.model.columns[effect]])


def _norms(jacobian: Array) -> Array:
    norms = np.linalg.norm(jacobian, axis=0)
    return np.where(norms > 0, norms, 1.0)


def refit(
    site: Site,
    effects: Sequence[Effect],
    observed: Observations,
    start: Array,
    coordinates: Array,
    *,
    priors: bool = False,
) -> Fit | None:
    """The rig of ``site`` with ``effects``, fitted to ``observed``.

    Args:
        site: the rig.
        effects: at work.
        observed: P poses.
        start: (N + k,) starting parameters.
        coordinates: (P, U) near which the poses settle.
        priors: whether the rig's stated uncertainties take part; those of effects never do.

    Returns:
        The fit, or None where the mechanism does not close at the start.
    """
    model, table = grow(site, effects)
    space = ParameterSpace.of(table)
    width = np.where(space.identified < model.named, space.uncertainty, np.inf)
    believed = np.isfinite(width) & priors
    nominal = space.reduce(space.nominal)

    def evaluate(
        z: Array, state: tuple[Array, Settled] | None
    ) -> Evaluation[tuple[Array, Settled]] | None:
        near = (
            coordinates
            if state is None
            else (state[1].coordinates + state[1].following @ (z - state[0]))
        )
        full = space.expand(z, start)
        found = settle(model, observed, near, full, space.expansion)
        if not found.closed.all():
            return None
        known, by_parameters = model.pseudo_observations(full, space.expansion)
        away = ((z - nominal) / width)[believed]
        return Evaluation(
            np.concatenate([found.residual.ravel(), known, away]),
            np.vstack(
                [
                    found.jacobian.reshape(-1, len(z)),
                    by_parameters,
                    (np.eye(len(z)) / width[:, None])[believed],
                ]
            ),
            (z, found),
        )

    minimum = minimise_held(evaluate, space.reduce(start), space, iterations=_ITERATIONS)
    if minimum is None:
        return None
    settled = minimum.last.state[1]
    cov, found = covariance(space, minimum.last.jacobian)
    closures = model.linearise(
        settled.coordinates[:1], start, space.expansion[:, :0], _first(observed)
    ).closure.shape[1]
    poses, channels = settled.residual.shape
    return Fit(
        effects=tuple(effects),
        model=model,
        space=space,
        observed=observed,
        parameters=space.expand(minimum.variables, start),
        settled=settled,
        known=minimum.last.residual[poses * channels :],
        jacobian=minimum.last.jacobian,
        covariance=cov,
        rank=found.rank,
        redundancy=channels - settled.coordinates.shape[1] + closures,
        priors=priors,
    )


def _first(observed: Observations) -> Circumstances | None:
    return None if observed.at is None else observed.at.take(np.array([0]))


def extended(fit: Fit, effect: Effect, coefficients: Array) -> Fit | None:
    """``fit`` with one more effect, that starts at ``coefficients`` (k,)."""
    start = np.concatenate([fit.parameters, coefficients])
    return refit(
        fit.model.site,
        (*fit.effects, effect),
        fit.observed,
        start,
        fit.settled.coordinates,
        priors=fit.priors,
    )


def without(fit: Fit, number: int) -> Fit | None:
    """``fit`` without one of its effects."""
    start = np.delete(fit.parameters, fit.model.columns[number])
    effects = tuple(e for i, e in enumerate(fit.effects) if i != number)
    return refit(
        fit.model.site,
        effects,
        fit.observed,
        start,
        fit.settled.coordinates,
        priors=fit.priors,
    )
