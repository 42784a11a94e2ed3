"""How fast a solve is, side by side in one run: python benchmarks/solve_speed.py

Three tables: the arm's 14 parameters from 50 poses, by this solver and by
scipy.optimize.least_squares with finite differences on the same residuals, from the same
start; choosing 50 of 450 poses with its certificate; and time against the number of poses.
Times are medians of repeated runs in one process with one thread for linear algebra; on a
shared machine compare the ratios.

Ends with exit code 1 when a limit is missed: 30 ms, 10 times, 1 s, and at 100,000 poses twice
the time a pose that 5,000 take.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from averaged_poses import Mechanism
from monte_carlo import console
from numpy.typing import NDArray
from rich.progress import track
from rich.table import Table
from scipy.optimize import least_squares

from solver.estimate import hinge, likelihood
from solver.estimate.nuisance import Observations, assemble, settle
from solver.poses.selection import select

Array = NDArray[np.float64]

SAMPLES = 40
SIZES = (50, 500, 5_000, 50_000, 100_000)
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median of ``repeats`` runs after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def solve_beside_scipy(arm: Mechanism) -> bool:
    """The 50-pose solve, and scipy on the same residuals; whether within the limits."""
    rng = np.random.default_rng(1)
    space, model = arm.space, arm.model
    observed = arm.session(arm.truth(rng), 50, SAMPLES, rng)
    start = space.reduce(space.nominal)
    first = assemble(model, observed, space.nominal)

    def eliminated(z: Array) -> Array:
        at = settle(model, observed, first, space.expand(z), space.expansion[:, :0])
        return at.residual.ravel()

    def closure(z: Array) -> Array:
        at = hinge.residual(model, observed.counts, space.expand(z), space.expansion[:, :0])
        return at.closure.residual.ravel()

    ours = likelihood.identify(model, space, observed)
    theirs = least_squares(eliminated, start, x_scale="jac")
    apart = np.abs(ours.values - theirs.x) / ours.standard_errors
    fast = median_seconds(lambda: likelihood.identify(model, space, observed), 15)
    slow = median_seconds(lambda: least_squares(eliminated, start, x_scale="jac"), 3)
    paper = median_seconds(lambda: hinge.identify(model, space, observed), 15)
    paper_slow = median_seconds(lambda: least_squares(closure, start, x_scale="jac"), 3)
    table = Table(title="arm: 14 parameters from 50 poses")
    for heading in ("residual", "solver", "scipy", "ratio", "largest difference"):
        table.add_column(heading, justify="left" if heading == "residual" else "right")
    table.add_row(
        "whitened readings, poses eliminated (ml)",
        f"{1e3 * fast:.1f} ms",
        f"{1e3 * slow:.0f} ms",
        f"{slow / fast:.0f}",
        f"{apart.max():.3f} standard errors",
    )
    table.add_row(
        "closure, hinge eliminated (hinge)",
        f"{1e3 * paper:.1f} ms",
        f"{1e3 * paper_slow:.0f} ms",
        f"{paper_slow / paper:.0f}",
        "",
    )
    console.print(table)
    return fast <= 0.030 and slow >= 10 * fast


def select_with_certificate(arm: Mechanism) -> bool:
    """Choosing 50 of 450 on both mechanisms; whether within the limit."""
    table = Table(title="50 of 450 poses, smallest singular value")
    for heading in ("rig", "time", "value", "upper bound", "gap"):
        table.add_column(heading, justify="left" if heading == "rig" else "right")
    within = True
    for at in (arm, Mechanism.named("shoulder")):
        rng = np.random.default_rng(2)
        nominal = at.space.nominal
        observed = Observations(
            at.readings(nominal, at.reached), np.tile(at.noise(SAMPLES), (len(at.reached), 1))
        )
        if at is arm:
            found = hinge.residual(at.model, observed.counts, nominal, at.space.expansion)
            rows = found.closure.by_parameters
        else:
            rows = settle(at.model, observed, at.reached, nominal, at.space.expansion).jacobian
        rows = rows[rng.permutation(len(rows))]
        chosen = select(rows, 50)
        took = median_seconds(lambda rows=rows: select(rows, 50), 3)
        table.add_row(
            at.rig.name,
            f"{took:.2f} s",
            f"{chosen.value:.4f}",
            f"{chosen.upper_bound:.4f}",
            f"{100 * (chosen.upper_bound / chosen.value - 1):.2f} %",
        )
        within &= took <= 1.0
    console.print(table)
    return within


def against_poses(arm: Mechanism, largest: int) -> bool:
    """Time and memory of maximum likelihood against the number of poses; whether linear."""
    table = Table(title="arm: 14 parameters, maximum likelihood")
    for heading in ("poses", "time", "a pose", "peak memory", "steps"):
        table.add_column(heading, justify="right")
    a_pose = {}
    rng = np.random.default_rng(3)
    truth = arm.truth(rng)
    exact = arm.readings(truth, arm.configurations(truth, 300, rng))
    sizes = [size for size in SIZES if size <= largest]
    for size in track(sizes, "poses", transient=True, disable=not sys.stdout.isatty()):
        counts = np.tile(exact, (size // len(exact) + 1, 1))[:size]
        sigma = np.tile(arm.noise(SAMPLES), (size, 1))
        observed = Observations(counts + sigma * rng.standard_normal(sigma.shape), sigma)
        began = time.perf_counter()
        estimate = likelihood.identify(arm.model, arm.space, observed)
        took = time.perf_counter() - began
        a_pose[size] = took / size
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        table.add_row(
            f"{size:,}",
            f"{took:.3f} s",
            f"{1e6 * took / size:.0f} µs",
            f"{memory:.0f} MB",
            str(estimate.iterations),
        )
    console.print(table)
    return largest < 100_000 or a_pose[100_000] <= 2 * a_pose[5_000]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--largest", type=int, default=100_000, help="number of poses at most")
    asked = parser.parse_args()
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        # The number of threads is read when numpy is loaded.
        again = [sys.executable, str(Path(__file__)), *sys.argv[1:]]
        sys.exit(subprocess.run(again, env=os.environ | ONE_THREAD, check=False).returncode)
    arm = Mechanism.named("arm")
    good = [
        solve_beside_scipy(arm),
        select_with_certificate(arm),
        against_poses(arm, asked.largest),
    ]
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
