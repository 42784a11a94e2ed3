"""Standard errors that a session will reach, before it is run.

From the whitened Jacobians of its stops: the Cramér-Rao bound at the noise of the channels and the
length of the dwells. A driven session goes where its plan says. A hand goes where it likes: of a
session by hand the errors are predicted over many draws of random poses within reach, as a median
and the range that the middle eight in ten of them fall into.

Of combinations that no pose determines the errors are those of `identifiability.covariance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.identifiability import (
    Identifiability,
    covariance_holding,
    prior_width,
    undetermined,
)
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_DRAWS = 40
_RANGE = (0.1, 0.9)
_MEMBER = 0.02  # of a held direction of unit length: more poses would not help such a parameter


@dataclass(frozen=True)
class Predicted:
    """What a number of poses will determine.

    Attributes:
        poses: distinct ones.
        errors: (n,) standard errors of the identified parameters, SI; by hand their median over draws.
        low, high: (n,) the 10 % and 90 % quantiles over draws; the errors themselves where the
            poses are given.
        worst: index of the parameter whose error is largest for its stated uncertainty (or for
            its plausible error, where none is stated), of those that poses determine.
    """

    poses: int
    errors: Array
    low: Array
    high: Array
    worst: int


def predict(
    space: ParameterSpace, stops: Array, poses: int, found: Identifiability, known: Array
) -> Predicted | None:
    """What stops with whitened Jacobians (S, C, n) determine of what can be determined at all.

    Args:
        space: the parameters.
        stops: one Jacobian a stop, revisits included.
        poses: how many of them are distinct.
        found: what all candidates together leave open.
        known: (D, n) whitened rows of what is known beside readings.

    Returns:
        None where the stops leave more open than ``found``.
    """
    errors = _errors(space, stops, found, known)
    if errors is None:
        return None
    return Predicted(poses, errors, errors, errors, _worst(space, errors, found))


def predict_by_hand(
    space: ParameterSpace,
    candidates: Array,
    poses: int,
    stops: Sequence[int],
    found: Identifiability,
    known: Array,
) -> Predicted | None:
    """What a hand reaches that goes to random ones of ``candidates``, whitened Jacobians (P, C, n).

    Args:
        space: the parameters.
        candidates: Jacobians of poses spread as a hand would spread them.
        poses: distinct ones of a session.
        stops: number of the pose at each stop, revisits included.
        found: what all candidates together leave open.
        known: (D, n) whitened rows of what is known beside readings.

    Returns:
        None where most draws leave more open than ``found``.
    """
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(_DRAWS):
        # With replacement: the candidates stand for a continuum.
        chosen = rng.integers(len(candidates), size=poses)[np.asarray(stops, dtype=np.intp)]
        errors = _errors(space, candidates[chosen], found, known)
        drawn.append(np.full(len(space.names), np.inf) if errors is None else errors)
    low, middle, high = np.quantile(drawn, (_RANGE[0], 0.5, _RANGE[1]), axis=0, method="nearest")
    if not np.isfinite(middle).all():
        return None
    return Predicted(poses, middle, low, high, _worst(space, middle, found))


def _errors(
    space: ParameterSpace, stops: Array, found: Identifiability, known: Array
) -> Array | None:
    rows = np.vstack([stops.reshape(-1, len(space.names)), known])
    jacobian = np.asarray(np.linalg.qr(rows, mode="r"))
    if undetermined(space, jacobian)[0].shape[1] > found.held.shape[1]:
        return None
    return np.sqrt(np.diag(covariance_holding(space, jacobian, found)))


def _worst(space: ParameterSpace, errors: Array, found: Identifiability) -> int:
    shown = np.abs(found.held).max(axis=1, initial=0.0) < _MEMBER
    relative = errors / prior_width(space)
    return int(np.argmax(np.where(shown, relative, -1.0) if shown.any() else relative))
