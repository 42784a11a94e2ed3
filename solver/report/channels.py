"""What each channel contributed: its noise, its samples, and how well its readings are explained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.report.notation import Unit, fine_unit
from solver.solve import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """One channel over all usable poses.

    Attributes:
        name: of the channel.
        senses: joint or leg.
        samples: median number averaged in a dwell.
        correlation: integrated autocorrelation time [samples].
        noise_counts: standard deviation of one sample.
        noise: the same in ``unit``.
        mean_error: standard error of a dwell's mean, in ``unit``, median over poses.
        unit: of ``noise`` and ``mean_error``.
        before: RMS residual of the selected poses at nominal parameters [standard errors].
        after: the same at the estimate.
        expected: what noise alone leaves.
    """

    name: str
    senses: str
    samples: int
    correlation: float
    noise_counts: float
    noise: float
    mean_error: float
    unit: Unit
    before: float
    after: float
    expected: float


def channel_summaries(solution: Solution, expected: Array) -> tuple[ChannelSummary, ...]:
    """A row a channel, in rig order; ``expected`` (P, C) as `leverage.expected_residuals` gives it."""
    table, chosen = solution.table, solution.selection.poses
    value = dict(
        zip(
            (p.name for p in solution.estimate.space.table),
            solution.estimate.parameters,
            strict=True,
        )
    )
    before, after = (
        np.where(settled.closed[:, None], settled.residual, np.nan)[chosen]
        for settled in (solution.before, solution.after)
    )
    out = []
    for c, channel in enumerate(solution.rig.channels):
        gain = abs(float(value[f"{channel.name}.gain"]))
        noise = float(table.noise[c]) * gain
        unit = fine_unit(solution.rig.dimension_of(channel.senses), noise)
        out.append(
            ChannelSummary(
                name=channel.name,
                senses=channel.senses,
                samples=int(np.median(table.samples[:, c])),
                correlation=float(table.correlation[c]),
                noise_counts=float(table.noise[c]),
                noise=noise / unit.to_si,
                mean_error=float(np.median(table.sigma[:, c])) * gain / unit.to_si,
                unit=unit,
                before=_rms(before[:, c]),
                after=_rms(after[:, c]),
                expected=_rms(expected[chosen, c]),
            )
        )
    return tuple(out)


def _rms(values: Array) -> float:
    """Root mean square of the numbers among ``values``; nan where there is none."""
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else float("nan")
