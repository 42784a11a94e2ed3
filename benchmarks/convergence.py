"""From how far the arm's calibration finds the truth: python benchmarks/convergence.py

Every run draws a truth from the rig's stated uncertainties and 50 averaged poses, then
starts with the hinge (a, s and alpha) off by up to 20 mm and 20 deg and every joint offset
off by up to 20 deg; the other identified parameters are off by their stated uncertainties.
"uniform" draws each error evenly between minus and plus its largest; "corner" takes the
largest, the sign by chance. A run counts when it reports convergence, its misfit is that of
noise, and every parameter is within six standard errors of the truth. Poses are where the
rig's planned drives take the arm, or anywhere that it reaches; those of "nature" come from the
simulator, whose kinematics shares no code with the solver.

Ends with exit code 1 when fewer than 99 % of any row find the truth.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from averaged_nature import averaged_nature
from averaged_poses import Mechanism
from monte_carlo import console, runs
from numpy.typing import NDArray
from rich.table import Table

from solver.estimate import hinge, likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.trust_region import Status

POSES, SAMPLES = 50, 40
LIMIT = 0.99
CASES = (
    ("uniform", "planned", 1.0),
    ("corner", "planned", 1.0),
    ("uniform", "anywhere", 1.0),
    ("corner", "anywhere", 1.0),
    ("uniform", "nature", 1.0),
    ("uniform", "planned", 2.0),
)

Array = NDArray[np.float64]


@cache
def mechanism(where: str) -> Mechanism:
    return Mechanism.named("arm", planned=where != "anywhere")


@dataclass(frozen=True)
class Run:
    """Whether maximum likelihood and the hinge method found the truth, steps and time of the former."""

    found: bool
    hinge_found: bool
    iterations: int
    seconds: float


def run(drawn: str, where: str, times: float, seed: int) -> Run:
    """The start of ``seed``, ``times`` as far away as the docstring says."""
    at = mechanism(where)
    space = at.space
    rng = np.random.default_rng([seed, 23])
    if where == "nature":
        truth, observed = averaged_nature(at.rig, 1000 + seed, POSES, SAMPLES)
    else:
        truth = at.truth(rng)
        observed = at.session(truth, POSES, SAMPLES, rng)
    largest = times * np.array([_largest(name) for name in space.names])
    error = rng.uniform(-1.0, 1.0, len(largest))
    if drawn == "corner":
        error = np.sign(error)
    off = np.where(
        largest > 0, largest * error, space.uncertainty * rng.standard_normal(len(largest))
    )
    start = space.expand(space.reduce(truth) + off)
    began = time.perf_counter()
    estimate = likelihood.identify(at.model, space, observed, start=start)
    took = time.perf_counter() - began
    true = space.reduce(truth)
    table = tuple(replace(p, nominal=x) for p, x in zip(space.table, start, strict=True))
    paper = hinge.identify(at.model, replace(space, table=table), observed)
    return Run(_is_truth(estimate, true), _is_truth(paper, true), estimate.iterations, took)


def _largest(name: str) -> float:
    if name == "hinge.alpha" or name.endswith("theta_offset"):
        return float(np.radians(20.0))
    return 0.02 if name.startswith("hinge.") else 0.0


def _is_truth(estimate: Estimate, true: Array) -> bool:
    errors = np.sqrt(np.diag(estimate.covariance))
    near = np.abs(estimate.values - true) <= 6 * errors
    return estimate.status is Status.CONVERGED and estimate.misfit < 2 and bool(near.all())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=400, help="starts a row (default: 400)")
    asked = parser.parse_args()
    table = Table(title=f"arm, {POSES} poses, 14 parameters, {asked.runs} starts a row")
    for heading in (
        "errors",
        "poses",
        "largest",
        "ml",
        "hinge method",
        "median steps",
        "median ms",
    ):
        table.add_column(heading, justify="left" if heading in ("errors", "poses") else "right")
    good = True
    for drawn, where, times in CASES:
        results = runs(partial(run, drawn, where, times), asked.runs, f"{drawn}, {where}")
        share = np.mean([r.found for r in results])
        good &= bool(share >= LIMIT) or times > 1
        table.add_row(
            drawn,
            where,
            f"{20 * times:.0f} mm, {20 * times:.0f}°",
            f"{100 * share:.1f} %",
            f"{100 * np.mean([r.hinge_found for r in results]):.1f} %",
            f"{np.median([r.iterations for r in results]):.0f}",
            f"{1e3 * np.median([r.seconds for r in results]):.0f}",
        )
    console.print(table)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
