"""How long a gap analysis takes: python benchmarks/gap_speed.py

Nature hides an effect, or nothing, and the recording is analysed as `loopcal gap` does. Wall time and
the processor's, one process with one thread for linear algebra; compare them with the first row, since
machines differ. Ends with exit code 1 when 300 poses take 20 s of the processor or more.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from recordings.reader import read_recording
from recordings.rig import parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.analysis import analyse

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
LIMIT_S = 20.0
POSES = 300
CASES = (
    ("arm", 80, ()),
    ("arm", POSES, ()),
    ("arm", POSES, ("nonlinearity@q6=1%",)),
    ("shoulder", POSES, ("nonlinearity@d3=1%",)),
)


def main() -> None:
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        # The number of threads is read when numpy is loaded.
        again = [sys.executable, str(Path(__file__))]
        sys.exit(subprocess.run(again, env=os.environ | ONE_THREAD, check=False).returncode)
    table = Table(title="gap analysis")
    for heading in ("rig", "poses", "dwells", "hidden", "found", "wall", "processor"):
        table.add_column(heading, justify="right" if heading in ("poses", "dwells") else "left")
    longest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, poses, hide) in enumerate(
            track(CASES, "sessions", transient=True, disable=not sys.stdout.isatty())
        ):
            text, source = rig_text(name)
            file = Path(folder) / f"{number}.mcap"
            simulate(parse_rig(text, source), text, file, poses=poses, seed=3, hide=hide)
            recording = read_recording(file)
            wall, processor = time.perf_counter(), time.process_time()
            gap = analyse(recording)
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            longest = max(longest, processor if poses == POSES else 0.0)
            table.add_row(
                name,
                str(poses),
                str(len(gap.table.counts)),
                ", ".join(hide) or "nothing",
                ", ".join(f"{e.name}@{e.where}" for e in gap.effects) or gap.verdict.value,
                f"{wall:.1f} s",
                f"{processor:.1f} s",
            )
    Console().print(table)
    sys.exit(0 if longest < LIMIT_S else 1)


if __name__ == "__main__":
    main()
