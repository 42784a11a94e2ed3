"""How accurate the estimates are, and how honest their intervals: python benchmarks/accuracy.py

Seeded Monte Carlo over the whole way from whole counts to parameters, on both papers'
mechanisms. Every run draws a truth from the rig's stated uncertainties, poses from those
that the mechanism reaches, and noisy counts; the noise is estimated from the samples, as for
any recording. The bound is the Cramér-Rao bound of each run, with the noise that was drawn:

    RMSE / bound   root mean square of (estimate - truth) / bound, 1 at best
    coverage       share of 95 % intervals, estimate +- 1.96 standard errors, that hold the truth

Ends with exit code 1 when maximum likelihood misses the limits.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from averaged_poses import Mechanism
from monte_carlo import console, runs
from numpy.typing import NDArray
from rich.table import Table

from solver.estimate.identifiability import covariance
from solver.estimate.methods import fitting
from solver.estimate.nuisance import Observations, settle
from solver.samples import average

Array = NDArray[np.float64]

POSES, SAMPLES = 50, 40
KNOWN = "ml, noise known"
NORMAL_95 = 1.959964
WORST_RATIO, COVERAGE = 1.05, (0.935, 0.965)

mechanism = cache(Mechanism.named)


@dataclass(frozen=True)
class Run:
    """One session: its bound (n,) and, for each method, errors (n,), standard errors (n,) and misfit.

    ``widened`` says for which methods the intervals were made wider than noise makes them.
    """

    bound: Array
    errors: dict[str, Array]
    claimed: dict[str, Array]
    misfit: dict[str, float]
    widened: dict[str, bool]


def run(name: str, seed: int) -> Run:
    """The session of ``seed`` on the rig ``name``, by every method that fits."""
    at = mechanism(name)
    rng = np.random.default_rng([seed, 17])
    truth = at.truth(rng)
    coordinates = at.configurations(truth, POSES, rng)
    table = average(at.recording(truth, coordinates, SAMPLES, rng))
    observed = Observations(table.counts, table.sigma)
    quantisation = np.where(at.noise(1) < 0.5, 1.0 / 12.0, 0.0)
    sigma = np.sqrt(at.noise(SAMPLES) ** 2 + quantisation)
    exact = Observations(at.readings(truth, coordinates), np.tile(sigma, (POSES, 1)))
    at_truth = settle(at.model, exact, coordinates, truth, at.space.expansion)
    flat = at_truth.jacobian.reshape(-1, len(at.space.names))
    bound = np.sqrt(np.diag(covariance(at.space, flat)[0]))
    estimates = {m.name: m.identify(at.model, at.space, observed) for m in fitting(at.model)}
    known = replace(observed, sigma=exact.sigma)
    estimates[KNOWN] = fitting(at.model)[0].identify(at.model, at.space, known)
    true = at.space.reduce(truth)
    return Run(
        bound,
        {method: e.values - true for method, e in estimates.items()},
        {method: e.standard_errors for method, e in estimates.items()},
        {method: e.misfit for method, e in estimates.items()},
        {
            method: e.inflation > 1.0 or (e.correlation is not None and e.correlation.significant)
            for method, e in estimates.items()
        },
    )


def tell(name: str, results: list[Run]) -> bool:
    """Print what ``results`` say of the rig; whether maximum likelihood is within the limits."""
    at = mechanism(name)
    summary = Table(title=f"{name}: {len(results)} sessions of {POSES} poses, {SAMPLES} samples")
    for heading in (
        "method",
        "RMSE / bound",
        "worst parameter",
        "coverage",
        "lowest",
        "highest",
        "misfit",
        "widened",
    ):
        summary.add_column(heading, justify="left" if heading == "method" else "right")
    bound = np.array([r.bound for r in results])
    ratio: dict[str, Array] = {}
    covered: dict[str, Array] = {}
    for method in results[0].errors:
        error = np.array([r.errors[method] for r in results])
        claimed = np.array([r.claimed[method] for r in results])
        ratio[method] = np.sqrt(np.mean((error / bound) ** 2, axis=0))
        covered[method] = np.mean(np.abs(error) <= NORMAL_95 * claimed, axis=0)
        summary.add_row(
            method,
            f"{np.sqrt(np.mean(ratio[method] ** 2)):.3f}",
            f"{ratio[method].max():.3f}",
            f"{100 * covered[method].mean():.1f} %",
            f"{100 * covered[method].min():.1f} %",
            f"{100 * covered[method].max():.1f} %",
            f"{np.mean([r.misfit[method] for r in results]):.3f}",
            f"{100 * np.mean([r.widened[method] for r in results]):.1f} %",
        )
    console.print(summary)
    each = Table(title=f"{name}: each parameter")
    for heading in ("parameter", "bound", "unit"):
        each.add_column(heading, justify="right" if heading == "bound" else "left", no_wrap=True)
    shown = [method for method in ratio if method != KNOWN]
    for method in shown:
        each.add_column(f"{method}: RMSE / bound", justify="right")
        each.add_column("coverage", justify="right")
    for i, index in enumerate(at.space.identified):
        parameter = at.space.table[index]
        cells = [f"{np.sqrt(np.mean(bound[:, i] ** 2)) / parameter.to_si:.2g}", parameter.unit]
        for method in shown:
            cells += [f"{ratio[method][i]:.3f}", f"{100 * covered[method][i]:.1f} %"]
        each.add_row(parameter.name, *cells)
    console.print(each)
    pooled = float(np.sqrt(np.mean(ratio["ml"] ** 2)))
    return pooled <= WORST_RATIO and COVERAGE[0] <= covered["ml"].mean() <= COVERAGE[1]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=400, help="sessions a rig (default: 400)")
    asked = parser.parse_args()
    within = [
        tell(name, runs(partial(run, name), asked.runs, name)) for name in ("arm", "shoulder")
    ]
    sys.exit(0 if all(within) else 1)


if __name__ == "__main__":
    main()
