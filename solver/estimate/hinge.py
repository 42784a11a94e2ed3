"""The hinge method of Giugovaz & Hollerbach: closure errors with the hinge angle eliminated.

With theta_z = atan2(R21, R11) of the chain without its hinge, the residual of a pose is
[dx-rot, dy-rot, dx, dy, dz] in the frame on the hinge axis (equations 11 to 13). Plain least
squares over all poses, metres and radians side by side, as the paper has it.

Fits serial chains that begin with one unsensed turning joint and are otherwise fully sensed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.errors import MethodError
from solver.estimate.estimate import Estimate
from solver.estimate.gauss_newton import Closure, expected_cost, propagate, solve
from solver.estimate.nuisance import Observations
from solver.estimate.trust_region import Status
from solver.mechanism.model import Model
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

NAME = "hinge"


def fits(model: Model) -> bool:
    """Whether the method applies to ``model``."""
    return (
        isinstance(model, SerialModel)
        and list(model.unsensed) == [0]
        and len(model.rows) == 6
        and model.chain.motions[0].kind == "turn"
        and model.chain.motions[0].axis == 2
    )


@dataclass(frozen=True)
class Hinged:
    """The residual at all poses, and the coordinates that it implies.

    Attributes:
        closure: residuals [rad, rad, m, m, m] with derivatives.
        coordinates: (P, U) sensed joints as measured, the hinge as eliminated.
    """

    closure: Closure
    coordinates: Array


def residual(model: SerialModel, counts: Array, parameters: Array, expansion: Array) -> Hinged:
    """Closure errors (P, 5) at measured ``counts`` (P, C) and ``parameters`` (N,)."""
    coordinates = np.zeros((len(counts), len(model.coordinate_names)))
    coordinates[:, model.sensed] = model.sensing.values(counts, parameters)
    along = model.along(expansion)
    # The hinge is motion 0, and moves: its screw comes first.
    moving = np.flatnonzero(model.coordinate_of.any(axis=1) | along.any(axis=1))
    rotation = model.chain.reach(coordinates, parameters, moving[:0]).rotation
    # The hinge is the chain's first motion: turning it back by the chain's own rotation about z closes it.
    coordinates[:, 0] -= np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    reached = model.chain.reach(coordinates, parameters, moving)
    by_motion = _errors_by_motion(reached.rotation, reached.screws)
    # The hinge follows every change so that theta_z stays eliminated: take its screw out.
    rate = _about_z(reached.rotation, reached.screws)
    by_motion = by_motion - by_motion[:, :, :1] * (rate / rate[:, :1])[:, None, :]
    values = np.stack([-reached.rotation[:, 1, 2], reached.rotation[:, 0, 2]], axis=1)
    error = np.concatenate([values, reached.position], axis=1)
    sensed = (by_motion @ model.coordinate_of[moving])[:, :, model.sensed]
    by_parameters = by_motion @ along[moving] + sensed @ model.sensing.by_parameters(
        counts, expansion
    )
    return Hinged(
        Closure(error, by_parameters, sensed * parameters[model.sensing.gain]), coordinates
    )


def _errors_by_motion(rotation: Array, screws: Array) -> Array:
    """(P, 5, M) rates of [-R23, R13, x, y, z] with every motion: dR = [omega] R."""
    omega, third = screws[:, 3:], rotation[:, :, 2, None]
    rate_x = omega[:, 1:2] * third[:, 2:3] - omega[:, 2:3] * third[:, 1:2]  # dR13
    rate_y = omega[:, 2:3] * third[:, 0:1] - omega[:, 0:1] * third[:, 2:3]  # dR23
    return np.concatenate([-rate_y, rate_x, screws[:, :3]], axis=1)


def _about_z(rotation: Array, screws: Array) -> Array:
    """(P, M) rate of atan2(R21, R11) with every motion."""
    omega, first = screws[:, 3:], rotation[:, :, 0]
    rate_11 = omega[:, 1] * first[:, 2:3] - omega[:, 2] * first[:, 1:2]
    rate_21 = omega[:, 2] * first[:, 0:1] - omega[:, 0] * first[:, 2:3]
    norm = first[:, 0:1] ** 2 + first[:, 1:2] ** 2
    return (first[:, 0:1] * rate_21 - first[:, 1:2] * rate_11) / norm


def identify(model: Model, space: ParameterSpace, observed: Observations) -> Estimate:
    """Parameters by the hinge method.

    Raises:
        MethodError: the mechanism has no hinge of this kind.
    """
    if not isinstance(model, SerialModel) or not fits(model):
        raise MethodError(
            "the method 'hinge' needs a serial chain whose first joint is an unsensed hinge, all others sensed"
        )
    start = space.reduce(space.nominal)

    def evaluate(z: Array) -> Closure:
        return residual(model, observed.counts, space.expand(z), space.expansion).closure

    solved = solve(evaluate, start)
    z, closure, status, iterations = (
        solved if solved else (start, evaluate(start), Status.DOES_NOT_CLOSE, 0)
    )
    parameters = space.expand(z)
    return Estimate(
        method=NAME,
        space=space,
        status=status,
        iterations=iterations,
        parameters=parameters,
        covariance=propagate(closure, observed.sigma),
        jacobian=closure.jacobian,
        residual=closure.residual.ravel(),
        coordinates=residual(model, observed.counts, parameters, space.expansion).coordinates,
        freedoms=closure.residual.size - len(z),
        misfit=closure.cost / expected_cost(closure, observed.sigma),
        held=np.zeros((len(z), 0)),
    )
