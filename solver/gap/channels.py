"""What the rest of the loop predicts each channel to read, beside what it read.

The reading of a channel at one pose, predicted from all others of that pose and the fitted
model: its residual over the share of it that the loop checks (the deleted residual of linear
regression, within the pose).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.estimate.nuisance import eliminated
from solver.gap.fit import Fit

Array = NDArray[np.float64]

_MOVED = 10.0  # times its noise
_UNCHECKED = 1e-6  # share of a reading's own noise below which nothing else of the loop sees it


@dataclass(frozen=True)
class Disagreement:
    """Measured minus predicted from the rest, P poses and C channels.

    Attributes:
        channels: names.
        units: in which differences are told, "deg" or "m".
        difference: (P, C) in those units; NaN where the rest of the loop says nothing.
        standard_error: (P, C) likewise.
        values: (P, C) where the channel stood, in those units.
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    difference: Array
    standard_error: Array
    values: Array


def disagreement(fit: Fit, noise: float = 1.0) -> Disagreement:
    """Of every channel with the rest of the loop, at ``fit``.

    Args:
        fit: the model.
        noise: standard deviation of the noise in units of the assumed one.
    """
    model, observed = fit.model, fit.observed
    share = checked(fit)
    rig = model.site.rig
    angular = np.array([rig.dimension_of(c.senses) == "angle" for c in rig.channels])
    shown = np.where(angular, 180.0 / np.pi, 1.0)
    gain = fit.parameters[model.sensing.gain] * shown
    return Disagreement(
        model.channels,
        tuple("deg" if a else "m" for a in angular),
        gain * observed.sigma * fit.residual / share,
        np.abs(gain) * observed.sigma * noise / np.sqrt(share),
        fit.values * shown,
    )


def checked(fit: Fit) -> Array:
    """(P, C) share of each reading that the rest of the loop checks; NaN where it checks nothing."""
    model, observed = fit.model, fit.observed
    here = model.linearise(
        fit.settled.coordinates,
        fit.parameters,
        np.zeros((len(fit.parameters), 0)),
        observed.at,
    )
    poses, channels = here.readings.shape
    # A change of the readings themselves is a change of what is predicted, the other way round.
    unit = -observed.sigma[:, :, None] * np.eye(channels)
    response, _ = eliminated(
        here, observed, unit, np.zeros((poses, here.closure.shape[1], channels))
    )
    share = np.einsum("pcc->pc", response)
    return np.where(share > _UNCHECKED, share, np.nan)


def moved(fit: Fit) -> NDArray[np.bool_]:
    """(C,) which channels moved by so much more than their noise that a pose is known by them.

    What is fitted to one that stood still (the play of a ball in its socket) is mostly its own error,
    and would seem to go with it.
    """
    spread = np.std(fit.observed.counts, axis=0)
    return np.asarray(spread > _MOVED * np.median(fit.observed.sigma, axis=0))
