"""Known distances between fixtures, as observations of the parameters alone.

Each is one whitened residual, (measured - predicted) / uncertainty, which sets the length
scale where joint angles alone cannot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Distance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnownDistances:
    """D measured distances.

    Attributes:
        ends: (D, 2, 3) indices of both ends' x, y, z in the parameter vector.
        measured: (D,) [m].
        uncertainty: (D,) [m].
    """

    ends: NDArray[np.intp]
    measured: Array
    uncertainty: Array

    @classmethod
    def of(cls, distances: Sequence[Distance], index: Mapping[str, int]) -> KnownDistances:
        """The distances of a rig; parameters by ``index`` of their names."""
        ends = [[[index[f"{end}.{k}"] for k in "xyz"] for end in d.between] for d in distances]
        return cls(
            np.array(ends, dtype=np.intp).reshape(-1, 2, 3),
            np.array([d.distance.nominal for d in distances]),
            np.array([d.distance.uncertainty for d in distances], dtype=np.float64),
        )

    def observe(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """Whitened residuals (D,) at ``parameters`` (N,) and their derivatives (D, n) along ``directions``."""
        apart = parameters[self.ends[:, 1]] - parameters[self.ends[:, 0]]
        length = np.linalg.norm(apart, axis=1)
        # Where both ends still coincide no direction is better than another.
        along = apart / np.where(length > 0, length, 1.0)[:, None]
        rate = np.einsum(
            "dk,dkn->dn", along, directions[self.ends[:, 1]] - directions[self.ends[:, 0]]
        )
        return (self.measured - length) / self.uncertainty, -rate / self.uncertainty[:, None]
