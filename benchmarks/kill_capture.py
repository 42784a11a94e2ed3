"""What kill -9 costs a capture: python benchmarks/kill_capture.py [--kills 20]

Virtual devices of the bundled shoulder run on pseudo-terminals. `loopcal capture` records them in
a process of its own and is killed at a random moment, again and again. Shown for each way of
forcing data to the disk: how old the last reading of the file is at the moment of the kill, at
most and on average, whether any reading before it is missing, and what `loopcal recover` saves.

Ends with exit code 1 where more than 0.5 s is lost, or a reading is missing before the end.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from monte_carlo import console
from rich.progress import track
from rich.table import Table

from recordings.recover import recover
from recordings.rig import load_rig
from recordings.survey import survey

MOST_S = 0.5
RIG = "shoulder"


def killed_capture(path: Path, ports: list[str], fsync: str, run_s: float) -> int:
    """Record to ``path`` and kill the recorder; returns the host time of the kill [ns]."""
    command = [sys.executable, "-m", "loopcal", "capture", RIG, "-o", str(path), "--fsync", fsync]
    with subprocess.Popen([*command, *ports], stdout=subprocess.DEVNULL) as capture:
        first = 0
        while first == 0 or path.stat().st_size == first:  # until the first flush
            first = first or (path.stat().st_size if path.exists() else 0)
            if capture.poll() is not None:
                raise SystemExit(f"the capture ended by itself with code {capture.returncode}")
            time.sleep(0.01)
        time.sleep(run_s)
        at_ns = time.time_ns()
        capture.kill()
    return at_ns


def main() -> int:
    words = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    words.add_argument("--kills", type=int, default=20, help="kills of each kind")
    kills = words.parse_args().kills
    rng = random.Random(1)
    table = Table("--fsync", "lost, worst", "lost, mean", "missing before", "saved", box=None)
    well = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        named = [(port.name, folder / port.name) for port in load_rig(RIG).ports]
        ports = [word for port, path in named for word in ("--port", f"{port}={path}")]
        bench = subprocess.Popen(
            [sys.executable, "-m", "loopcal", "sim", RIG, *ports], stdout=subprocess.DEVNULL
        )
        try:
            while not all(path.exists() for _, path in named):
                time.sleep(0.05)
            for fsync in ("flush", "never"):
                ages, missing, saved = [], 0, 0
                for number in track(range(kills), fsync, console=console, transient=True):
                    path = folder / f"{fsync}-{number}.mcap"
                    at_ns = killed_capture(path, ports, fsync, rng.uniform(0.5, 3.0))
                    found = survey(path)
                    last_ns = min(found.channel(name).last_ns for name in found.readings)
                    ages.append((at_ns - last_ns) / 1e9)
                    missing += sum(tally.missing or 0 for tally in found.topics.values())
                    target = folder / "saved.mcap"
                    target.unlink(missing_ok=True)
                    done = recover(path, target)
                    saved += done.messages == sum(t.count for t in found.topics.values())
                well &= max(ages) <= MOST_S and not missing and saved == kills
                mean = sum(ages) / len(ages)
                row = (f"{max(ages):.2f} s", f"{mean:.2f} s", str(missing))
                table.add_row(fsync, *row, f"{saved} of {kills} files")
        finally:
            bench.terminate()
            bench.wait()
    console.print(table)
    if not well:
        console.print(f"[red]more than {MOST_S} s lost, or readings missing before the end[/red]")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
