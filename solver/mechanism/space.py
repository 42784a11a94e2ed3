"""The parameter vector of a model: names, units, which entries are identified, which follow others.

Full vectors x hold every parameter of the rig in table order, SI. Reduced vectors z hold
the identified ones only; x = start + expansion (z - z_start) carries the ties along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Parameter
from solver.errors import SolverError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ParameterSpace:
    """Every parameter of a rig, and the subspace that a solve moves in.

    Attributes:
        table: all N parameters, in rig order.
        identified: (n,) indices into ``table`` of the estimated ones.
        expansion: (N, n), change of the full vector with the reduced one; a tie is a row
            that is a multiple of another.
    """

    table: tuple[Parameter, ...]
    identified: NDArray[np.intp]
    expansion: Array

    @classmethod
    def of(
        cls, table: Sequence[Parameter], identify: Sequence[str] | None = None
    ) -> ParameterSpace:
        """The space of ``table`` with the rig's own choice of what to identify, or ``identify``.

        Raises:
            SolverError: a name in ``identify`` is unknown or tied.
        """
        index = {parameter.name: i for i, parameter in enumerate(table)}
        if identify is None:
            chosen = [p.name for p in table if p.identify]
        else:
            chosen = list(identify)
            for name in chosen:
                if name not in index:
                    raise SolverError(
                        f"there is no parameter '{name}' to identify; the rig has: {', '.join(index)}"
                    )
                if table[index[name]].tie is not None:
                    raise SolverError(f"'{name}' is tied to another parameter; identify that one")
        identified = np.array([index[name] for name in chosen], dtype=np.intp)
        expansion = np.zeros((len(table), len(chosen)))
        expansion[identified, np.arange(len(chosen))] = 1.0
        column = {name: j for j, name in enumerate(chosen)}
        for i, parameter in enumerate(table):
            if parameter.tie is not None and parameter.tie.parameter in column:
                expansion[i, column[parameter.tie.parameter]] = parameter.tie.factor
        return cls(tuple(table), identified, expansion)

    @property
    def nominal(self) -> Array:
        """(N,) values before calibration, SI."""
        return np.array([parameter.nominal for parameter in self.table])

    @property
    def uncertainty(self) -> Array:
        """(n,) prior standard uncertainties of the identified parameters, SI; inf where none is stated."""
        stated = [self.table[i].uncertainty for i in self.identified]
        return np.array([np.inf if value is None else value for value in stated])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the identified parameters, in column order."""
        return tuple(self.table[i].name for i in self.identified)

    def reduce(self, full: Array) -> Array:
        """(n,) identified entries of a full vector."""
        return full[self.identified]

    def expand(self, reduced: Array, start: Array | None = None) -> Array:
        """(N,) full vector at ``reduced``; entries that are not identified come from ``start`` (nominal)."""
        base = self.nominal if start is None else start
        return base + self.expansion @ (reduced - self.reduce(base))
