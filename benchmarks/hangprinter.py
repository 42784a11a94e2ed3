"""Anchors of a real cable machine from its own lines: python benchmarks/hangprinter.py

Writes the eleven published poses as a recording of the bundled rig `hangprinter`, reads it
back, and identifies the nine anchor coordinates that the frame leaves open, three ways: from
the lines alone, with the hand measurements as priors of 50 mm, and so again at 20 mm. Each
pose has one redundant line: eleven rows, of which two are the same, are ten equations for nine
unknowns. Intervals are 95 %, of reading noise as the rig states it (1 mm), widened where the
misfit asks for it.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from recordings.events import Dwell
from recordings.reader import Recording, read_recording
from recordings.rig import Rig, parameters, parse_rig, rig_text
from recordings.session import Session
from recordings.writer import Writer
from solver.estimate import likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.nuisance import Observations
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.samples import average

SAMPLES = Path(__file__).parent / "data" / "hangprinter" / "samples.csv"
MM = 1e-3
COUNTS_PER_MM = 100  # the table has two decimals
SECOND = 1_000_000_000
T95 = 1.96


def recorded(path: Path) -> Recording:
    """The published table as a recording: one reading of every line at every pose."""
    text, _ = rig_text("hangprinter")
    counts = np.rint(np.loadtxt(SAMPLES, delimiter=",") * COUNTS_PER_MM).astype(np.int64)
    with Writer(path, text, Session(start_ns=0, notes=f"from {SAMPLES.name}")) as writer:
        for pose, row in enumerate(counts):
            begin = (pose + 1) * SECOND
            for line, raw in zip("ABCD", row, strict=True):
                writer.write_readings(f"d{line}", [begin + SECOND // 4], [raw])
            end = begin + SECOND // 2
            writer.write(Dwell(end, begin, end, pose, 0))
    return read_recording(path)


def solved(rig: Rig, observed: Observations, prior_mm: float | None) -> Estimate:
    """Anchors, with hand measurements of the given standard uncertainty as priors, or without."""
    table = tuple(
        replace(p, uncertainty=MM * prior_mm if prior_mm and p.identify else None)
        for p in parameters(rig)
    )
    space = ParameterSpace.of(table)
    return likelihood.identify(model_of(rig), space, observed, use_priors=prior_mm is not None)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        recording = recorded(Path(folder) / "hangprinter.mcap")
        table = average(recording)
    rig = parse_rig(recording.rig_toml)
    observed = Observations(table.counts, table.sigma)
    distinct = observed.take(np.unique(table.counts, axis=0, return_index=True)[1])
    cases = {
        "lines alone": solved(rig, distinct, None),
        "hand 50 mm": solved(rig, distinct, 50.0),
        "hand 20 mm": solved(rig, distinct, 20.0),
    }
    print(f"{len(table.counts)} poses, {len(distinct.counts)} of them different")
    print(f"{'anchor':8}{'by hand':>9}" + "".join(f"{name:>22}" for name in cases) + "   [mm]")
    names = cases["lines alone"].space.names
    hand = {p.name: p.nominal for p in parameters(rig)}
    for k, name in enumerate(names):
        row = f"{name:8}{hand[name] / MM:9.0f}"
        for estimate in cases.values():
            half = T95 * estimate.standard_errors[k] / MM
            row += f"{estimate.values[k] / MM:12.1f} ±{half:8.1f}"
        print(row)
    for name, estimate in cases.items():
        own = estimate.residual[: distinct.counts.size]
        lines = np.sqrt(np.sum(own**2) / len(distinct.counts))
        print(
            f"{name}: {estimate.status.word}, misfit {estimate.misfit:.2f} "
            f"({estimate.freedoms} degrees of freedom), inconsistency of the lines "
            f"{lines:.2f} mm a pose, not determined: {estimate.held.shape[1]}, "
            f"standard errors x {estimate.inflation:.2f}"
        )
    singular = np.linalg.svd(
        cases["lines alone"].jacobian[: distinct.counts.size] * MM, compute_uv=False
    )
    print(
        "standard errors of the nine directions, lines alone [mm]: "
        + ", ".join(f"{1 / s:.1f}" for s in singular)
    )


if __name__ == "__main__":
    main()
