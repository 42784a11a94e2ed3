"""Forward kinematics: where the end of a chain is, by its readings alone, on the fixture or away from it.

Needs a sensor at every joint between the base and the end. What effects do to sensors and to the
geometry is undone; the closure takes no part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from solver.effects.grown import Grown
from solver.errors import MechanismError
from solver.estimate.nuisance import Observations
from solver.mechanism.model import EndPose, Model
from solver.mechanism.serial import SerialModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Forward:
    """The end at P readings.

    Attributes:
        end: its pose, ``by_parameters`` at fixed readings.
        by_readings: (P, 6, C) its rate with the readings [m or rad per count].
    """

    end: EndPose
    by_readings: Array


def sensed_all_the_way(model: Model) -> bool:
    """Whether ``model`` is a chain and every joint between its base and its end has a channel."""
    chain = _chain(model)
    if chain is None:
        return False
    used = {m.coordinate for m in chain.chain.motions[chain.base : chain.end] if m.coordinate >= 0}
    return used <= set(chain.sensed.tolist())


def read(model: Model, counts: Array, parameters: Array) -> Array:
    """(P, U) coordinates of a chain that its straight sensors show at ``counts`` (P, C), effects left out."""
    chain = _chain(model)
    if chain is None:
        raise MechanismError("only a chain of joints is read so")
    coordinates = np.zeros((len(counts), len(chain.coordinate_names)))
    named = parameters[: model.named] if isinstance(model, Grown) else parameters
    coordinates[:, chain.sensed] = chain.sensing.values(counts, named)
    return coordinates


def forward(model: Model, observed: Observations, parameters: Array, directions: Array) -> Forward:
    """The end of a chain that is `sensed_all_the_way`.

    Args:
        model: with or without effects.
        observed: readings of P poses, with the circumstances that effects depend on; what nobody
            knows of them has no effect.
        parameters: (N,).
        directions: (N, n), to differentiate along.

    Raises:
        MechanismError: not such a chain, or no values could give such readings.
    """
    chain = _chain(model)
    if chain is None or not sensed_all_the_way(model):
        raise MechanismError(
            "forward kinematics needs a chain with a sensor at every joint between base and end"
        )
    coordinates = read(model, observed.counts, parameters)
    if isinstance(model, Grown):
        values, by_counts, following = model.sensed(
            observed.counts, parameters, directions, observed.at
        )
        coordinates[:, chain.sensed] = values
    else:
        by_counts = np.diag(parameters[chain.sensing.gain])
        following = chain.sensing.by_parameters(observed.counts, directions)
    end = model.end_pose(coordinates, parameters, directions, observed.at)
    by_values = end.by_coordinates[:, :, chain.sensed]
    at_readings = replace(end, by_parameters=end.by_parameters + by_values @ following)
    return Forward(at_readings, by_values @ by_counts)


def _chain(model: Model) -> SerialModel | None:
    plain = model.plain if isinstance(model, Grown) else model
    return plain if isinstance(plain, SerialModel) else None
