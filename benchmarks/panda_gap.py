"""What is missing from the model of a real arm: python benchmarks/panda_gap.py [ARM PLACE]...

Franka Pandas with a ball in two sockets (`data/panda_ball_joint`), each place analysed alone, with
the uncertainties that the calibration benchmark's training place made likely. Every pose was
recorded once and as one reading, so that there is no noise floor but the stated one.
"""

from __future__ import annotations

import csv
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from panda_arm import FOLDER, TRAINED, Choice, poses, rig_text_of

from recordings.reader import read_recording
from recordings.rig import parse_rig
from recordings.tables import Table, import_tables
from recordings.urdf import COUNT
from solver.gap.analysis import analyse
from solver.gap.result import Gap

RIGID = Choice(0.14e-3, 0.07e-3, 1e-3, 3e-3, 10e-3)
ELASTIC = replace(RIGID, compliance=2e-5, bearing=2e-5)
CASES = (("panda_2_clean", TRAINED), ("panda_3", "frontcenter"))


def analysed(place: str, choice: Choice) -> Gap:
    """The gap of one place, from tables as a user would bring them."""
    text = rig_text_of(choice)
    rig = parse_rig(text)
    angles, sockets = poses(place)
    with tempfile.TemporaryDirectory() as folder:
        tables = []
        for k in (0, 1):
            path = Path(folder) / f"hole_{k}.csv"
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow([f"{channel.name}_counts" for channel in rig.channels])
                for row in angles[sockets == k]:
                    writer.writerow([*(round(a / COUNT) for a in row), 0, 0, 0])
            tables.append(Table(path, f"hole_{k}"))
        recording = Path(folder) / "place.mcap"
        import_tables(rig, text, tables, recording)
        return analyse(read_recording(recording))


def tell(title: str, gap: Gap, took_s: float) -> None:
    """Print what the analysis says."""
    held = gap.held_out
    print(f"\n{title}: {gap.verdict.value}{', provisional' * gap.provisional}, {took_s:.0f} s")
    for reason in gap.reasons:
        print(f"  {reason}")
    if held is not None:
        print(f"  gap on {held.poses} held-out poses: {held.before:.3f} -> {held.after:.3f}")
    for named in gap.search.named:
        best = named.best
        print(
            f"  came near: {best.effect.label}, chi-square {best.explained:.0f}, "
            f"rivals: {', '.join(r.effect.label for r in named.rivals) or 'none'}"
        )
    look = gap.search.before
    order = np.argsort(-look.screen.log_evidence)[:6]
    ranked = [f"{look.candidates[i].label} ({look.screen.log_evidence[i]:.1f})" for i in order]
    print(f"  likeliest by themselves (log evidence): {', '.join(ranked)}")


def main() -> None:
    asked = sys.argv[1:]
    cases = tuple(zip(asked[::2], asked[1::2], strict=True)) or CASES
    for arm, place in cases:
        if place not in FOLDER:
            sys.exit(f"there is no place '{place}'; there are: {', '.join(FOLDER)}")
        for words, choice in (("rigid joints", RIGID), ("elastic joints", ELASTIC)):
            start = time.process_time()
            gap = analysed(place, choice)
            tell(f"{arm}, {place}, {words}", gap, time.process_time() - start)


if __name__ == "__main__":
    main()
