"""How well a set of poses shows the parameters: singular values and the indices made of them.

The three indices of Nahvi, Hollerbach & Hayward, equations 12 to 14: the smallest singular
value, the root of the product over the root of the number of measurements, and the
condition number; each of the Jacobian as it is (raw) and with unit columns (scaled).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Observability:
    """Indices of one Jacobian.

    Attributes:
        singular_values: (n,), largest first.
        sigma_min: equation 12.
        product: equation 13.
        condition: equation 14; inf where a direction is not seen at all.
    """

    singular_values: Array
    sigma_min: float
    product: float
    condition: float


def observability(jacobian: Array, *, scaled: bool) -> Observability:
    """Indices of ``jacobian`` (M, n), with unit columns where ``scaled``."""
    rows, columns = jacobian.shape
    if rows < columns or columns == 0:
        return Observability(np.zeros(columns), 0.0, 0.0, float("inf"))
    if scaled:
        norms = np.linalg.norm(jacobian, axis=0)
        jacobian = jacobian / np.where(norms > 0, norms, 1.0)
    singular: Array = np.asarray(np.linalg.svd(jacobian, compute_uv=False), dtype=np.float64)
    smallest = float(singular[-1])
    with np.errstate(divide="ignore"):
        product = float(np.exp(np.mean(np.log(singular))) / np.sqrt(rows))
    condition = float(singular[0] / smallest) if smallest > 0 else float("inf")
    return Observability(singular, smallest, product, condition)
