"""All 20 parameters of the shoulder from a 2 % wrong start: python benchmarks/shoulder_all_parameters.py [SEEDS]

Every seed draws each parameter, gains included, with a standard deviation of 2 % around its
nominal value (1.4 mm where that is zero); nature simulates 100 poses, 15 samples each; the
search starts at the nominal values. It counts as converged where it says so, its misfit is
what noise leaves (99.9 %), and the truth explains the readings no worse than it should: the
likelihood ratio of estimate and truth is below the 99.9 % point of chi-square. That does not see
the gauges. There are two: legs 1 and 2 meet legs 3 and 4 only through the plate's orientation,
which has no size, so that A1, A2, B1 with the offsets and gains of d1 and d2 have one common
scale, and A3, A4, B2 with those of d3 and d4 another. Both together are the common scale of
all lengths and gains.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

import numpy as np
from scipy.stats import chi2

from benchmarks.averaged_nature import averaged_nature
from recordings.rig import load_rig, parameters
from solver.estimate import likelihood
from solver.estimate.identifiability import identifiability
from solver.estimate.nuisance import settle
from solver.estimate.trust_region import Status
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace

POSES, SAMPLES = 100, 15


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    rig = load_rig("shoulder-all")
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    steps, misfits, ratios, gauges = [], [], [], Counter[tuple[str, ...]]()
    converged, took_s = 0, 0.0
    for seed in range(seeds):
        truth, observed = averaged_nature(rig, seed, POSES, SAMPLES)
        start = time.perf_counter()
        estimate = likelihood.identify(model, space, observed)
        took_s += time.perf_counter() - start
        found = identifiability(space, estimate.jacobian, estimate.parameters)
        gauges.update(tuple(sorted(direction.members)) for direction in found.directions)
        at_truth = settle(model, observed, estimate.coordinates, truth, space.expansion)
        ratio = at_truth.cost - float(estimate.residual @ estimate.residual)
        right = (
            estimate.status is Status.CONVERGED
            and estimate.misfit * estimate.freedoms < chi2.ppf(0.999, estimate.freedoms)
            and ratio < chi2.ppf(0.999, found.rank)
        )
        converged += right
        steps.append(estimate.iterations)
        misfits.append(estimate.misfit)
        ratios.append(ratio / found.rank)
        if not right:
            print(
                f"seed {seed}: {estimate.status.word}, misfit {estimate.misfit:.3g}, ratio {ratio:.3g}"
            )
    print(f"converged on the truth: {converged} of {seeds} ({100 * converged / seeds:.1f} %)")
    print(f"steps: {min(steps)} to {max(steps)}, {np.median(steps):.0f} usually")
    print(f"misfit: mean {np.mean(misfits):.3f} (noise alone: 1)")
    print(f"likelihood ratio / rank: mean {np.mean(ratios):.3f} (theory: 1)")
    print(f"time: {1e3 * took_s / seeds:.0f} ms a solve")
    for members, count in gauges.most_common():
        print(f"not determined in {count} of {seeds}: a common scale of {', '.join(members)}")


if __name__ == "__main__":
    main()
