"""Each identified parameter beside its nominal value, the other methods' results, and the truth.

Values are in the units people read (mm, deg); parameters stand in the rig's order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solver.report.notation import Unit, unit_of
from solver.solve import Solution

_SHARE_OF_A_HELD_DIRECTION = 0.1


@dataclass(frozen=True, slots=True)
class Value:
    """A number with its standard error; nan where there is none."""

    value: float
    standard_error: float


@dataclass(frozen=True, slots=True)
class Compared:
    """One identified parameter, everything in ``unit``.

    Attributes:
        name: of the parameter.
        unit: of all numbers here.
        estimate: the chosen method's result.
        nominal: value before calibration.
        prior: stated standard uncertainty of the nominal value, or None.
        beside: results of the other methods, in the order of `Solution.beside`.
        truth: what it really is, where that is known.
        held: whether the poses leave it (partly) undetermined.
    """

    name: str
    unit: Unit
    estimate: Value
    nominal: float
    prior: float | None
    beside: tuple[Value, ...]
    truth: float | None
    held: bool

    @property
    def change(self) -> float:
        """Estimate minus nominal."""
        return self.estimate.value - self.nominal

    def in_errors(self, difference: float) -> float:
        """``difference`` in standard errors of the estimate; nan where that has none."""
        error = self.estimate.standard_error
        return difference / error if error > 0 else float("nan")


def compare(solution: Solution, truth: Mapping[str, float] | None = None) -> tuple[Compared, ...]:
    """The identified parameters of ``solution``.

    Args:
        solution: the solve.
        truth: true values by parameter name, in the units of the result file (m, deg, m/count,
            deg/count); parameters that it does not name have no truth.
    """
    space, estimate = solution.estimate.space, solution.estimate
    known = {} if truth is None else truth
    undetermined = np.abs(solution.identifiability.held).max(axis=1, initial=0.0)
    out = []
    for j, i in enumerate(space.identified):
        parameter = space.table[i]
        unit = unit_of(parameter)
        true = known.get(parameter.name)
        out.append(
            Compared(
                name=parameter.name,
                unit=unit,
                estimate=Value(
                    float(estimate.values[j] / unit.to_si),
                    float(estimate.standard_errors[j] / unit.to_si),
                ),
                nominal=parameter.nominal / unit.to_si,
                prior=None if parameter.uncertainty is None else parameter.uncertainty / unit.to_si,
                beside=tuple(
                    Value(
                        float(other.values[j] / unit.to_si),
                        float(other.standard_errors[j] / unit.to_si),
                    )
                    for other in solution.beside
                ),
                truth=None if true is None else float(true) * parameter.to_si / unit.to_si,
                held=bool(undetermined[j] > _SHARE_OF_A_HELD_DIRECTION),
            )
        )
    return tuple(out)
