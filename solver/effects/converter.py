"""Expected codes of a converter: the mean of a Gaussian reading after a law that maps codes to codes.

For a reading of mean y and standard deviation s, rounded to codes c,

    E[f(c)] - E[c] = sum_c (f(c) - c) (Phi((c + 1/2 - y) / s) - Phi((c - 1/2 - y) / s)),

an exact sum with a smooth slope. What rounding itself does to the mean is left out, as it is
everywhere else in the model: the sum is added to y. Readings that are quieter than the rounding
error of a count are taken to be as wide as that, so that slopes stay finite.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Codes = NDArray[np.int64]

_ROUNDING = 12.0**-0.5  # counts
_REACH = 8.0  # standard deviations that a sum covers


def spread(noise: Array | None, channel: int, poses: int) -> Array:
    """(P,) standard deviation [counts] of one sample of a channel, out of ``noise`` (P, C)."""
    known = np.zeros(poses) if noise is None else noise[:, channel]
    return np.asarray(np.maximum(known, _ROUNDING), dtype=np.float64)


def density(z: Array) -> Array:
    """The standard normal density."""
    return np.asarray(np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi), dtype=np.float64)


def below(z: Array) -> Array:
    """The standard normal distribution function."""
    from scipy.special import ndtr  # heavy to import: only where it is needed

    return np.asarray(ndtr(z), dtype=np.float64)


def expected(mean: Array, sigma: Array, law: Callable[[Codes], Codes]) -> tuple[Array, Array]:
    """(P,) expected codes behind ``law``, and (P,) their slope with ``mean`` (P,) [counts]."""
    reach = int(np.ceil(_REACH * float(sigma.max()))) + 1
    codes = np.round(mean).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    change = (law(codes) - codes).astype(np.float64)
    edges = (np.concatenate([codes - 0.5, codes[:, -1:] + 0.5], axis=1) - mean[:, None]) / (
        sigma[:, None]
    )
    chance = np.diff(below(edges), axis=1)
    rising = -np.diff(density(edges), axis=1) / sigma[:, None]
    return mean + np.sum(change * chance, axis=1), 1.0 + np.sum(change * rising, axis=1)
