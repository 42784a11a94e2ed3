"""Closed loop against open loop on the shoulder: python benchmarks/shoulder_table1.py [SEEDS]

The comparison of Nahvi, Hollerbach & Hayward, Table 1, on a simulated shoulder. The closed
loop has the legs alone: 450 poses, of which the 50 that tell most are used. The open loop has
legs and an optical tracker with three markers on the plate: 100 poses. Every reading of either
is averaged 10 times. Where the camera stands and where the markers sit is unknown, which makes
15 parameters more.
Nature simulates both with kinematics of its own. The table is of seed 1; the root mean square
errors below it are of all seeds.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from benchmarks.averaged_nature import averaged_nature
from recordings.rig import parameters, parse_rig, rig_text
from solver.estimate import likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.nuisance import settle
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.selection import select

TRACKER = Path(__file__).parent / "data" / "shoulder_tracker.toml"
SHOWN = ("d1.offset", "d2.offset", "d3.offset", "d4.offset", "A1.x", "A2.x", "A2.y")
OFFSETS, GEOMETRY = slice(0, 4), slice(4, 7)
SAMPLES = 10
MM = 1e-3


def closed_loop(seed: int) -> tuple[Estimate, np.ndarray]:
    """Estimate from the legs alone, and the true parameters in `SHOWN`."""
    rig = parse_rig(rig_text("shoulder")[0])
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed = averaged_nature(rig, seed, 450, SAMPLES)
    first = likelihood.identify(model, space, observed)
    settled = settle(model, observed, first.coordinates, first.parameters, space.expansion)
    chosen = observed.take(select(settled.jacobian, 50).poses)
    return likelihood.identify(model, space, chosen), _shown(space, truth)


def open_loop(seed: int) -> tuple[Estimate, np.ndarray]:
    """Estimate from legs and tracker, and the true parameters in `SHOWN`."""
    rig = parse_rig(rig_text("shoulder")[0] + "\n" + TRACKER.read_text("utf-8"))
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    truth, observed = averaged_nature(rig, seed, 100, SAMPLES)
    return likelihood.identify(model, space, observed), _shown(space, truth)


def _shown(space: ParameterSpace, full: np.ndarray) -> np.ndarray:
    names = [p.name for p in space.table]
    return np.array([full[names.index(name)] for name in SHOWN])


def _errors(estimate: Estimate) -> np.ndarray:
    names = list(estimate.space.names)
    return np.array([estimate.standard_errors[names.index(name)] for name in SHOWN])


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2))) / MM


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    gaps: dict[str, list[np.ndarray]] = {"open": [], "closed": []}
    pulls: dict[str, list[np.ndarray]] = {"open": [], "closed": []}
    for seed in range(1, seeds + 1):
        solved = {"open": open_loop(seed), "closed": closed_loop(seed)}
        for kind, (estimate, truth) in solved.items():
            gap = _shown(estimate.space, estimate.parameters) - truth
            gaps[kind].append(gap)
            pulls[kind].append(gap / _errors(estimate))
        if seed == 1:
            _table(solved)
    print(f"\nover {seeds} seeds, root mean square error against the truth [mm]:")
    for kind in ("open", "closed"):
        every = np.array(gaps[kind])
        print(
            f"  {kind + ' loop':12} offsets {_rms(every[:, OFFSETS]):.4f}, geometry "
            f"{_rms(every[:, GEOMETRY]):.4f}; error / standard error: rms "
            f"{np.sqrt(np.mean(np.array(pulls[kind]) ** 2)):.3f}"
        )


def _table(solved: dict[str, tuple[Estimate, np.ndarray]]) -> None:
    estimates = {kind: estimate for kind, (estimate, _) in solved.items()}
    truth = solved["open"][1]
    if not np.array_equal(truth, solved["closed"][1]):
        raise ValueError("both loops must be of one mechanism")
    nominal = _shown(estimates["closed"].space, estimates["closed"].space.nominal)
    print(f"{'[mm]':10}{'blueprint':>10}{'open loop':>21}{'closed loop':>21}{'truth':>10}")
    columns = {
        kind: (_shown(e.space, e.parameters) / MM, _errors(e) / MM) for kind, e in estimates.items()
    }
    for k, name in enumerate(SHOWN):
        print(
            f"{name:10}{nominal[k] / MM:10.2f}"
            + "".join(f"{v[k]:12.3f} ± {s[k]:.3f} " for v, s in columns.values())
            + f"{truth[k] / MM:10.3f}"
        )
    away = {kind: values * MM - truth for kind, (values, _) in columns.items()}
    print(
        f"{'RMS error':10}{_rms(nominal - truth):10.2f}"
        + "".join(f"{_rms(gap):12.3f}         " for gap in away.values())
    )
    print(
        f"{'geometry':10}{_rms((nominal - truth)[GEOMETRY]):10.2f}"
        + "".join(f"{_rms(gap[GEOMETRY]):12.3f}         " for gap in away.values())
    )
    for kind, estimate in estimates.items():
        print(
            f"{kind} loop: {len(estimate.coordinates)} poses, {len(estimate.space.names)} unknowns, "
            f"rank {len(estimate.space.names) - estimate.held.shape[1]}, "
            f"misfit {estimate.misfit:.2f}"
        )


if __name__ == "__main__":
    main()
