"""An hour of seven channels at 1 kHz, from file to averaged poses: python benchmarks/hour_of_readings.py

Writes a recording of 25.2 million readings with this program's own writer, a second at a time:
a pose every ten seconds, six of them at rest, whole counts, white noise, and no dwell messages,
so that the dwells must be found. Then a process of its own reads it, finds the dwells and
averages them, and says what each step took and the most memory it ever held.

Ends with exit code 1 above 30 s or 1.5 GiB, or where a dwell is missing or a mean is off.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from monte_carlo import console
from numpy.typing import NDArray
from rich.progress import track
from rich.table import Table

from recordings.reader import read_recording
from recordings.rig import parse_rig, rig_text
from recordings.session import Session
from recordings.writer import Writer
from solver.samples import average

LONGEST_S, MOST_GIB = 30.0, 1.5
RATE = 1000
POSE_S, MOVE_S = 10.0, 4.0
START_NS = 1_700_000_000_000_000_000
NOISE = 2.0


def levels(poses: int, channels: int) -> NDArray[np.float64]:
    """(poses, channels) counts at rest."""
    return np.random.default_rng(7).uniform(-1000, 1000, (poses, channels))


def write(path: Path, seconds: int) -> None:
    """The recording; every pose is reached along half a cosine."""
    text, source = rig_text("arm")
    channels = parse_rig(text, source).channels
    rest = levels(int(seconds / POSE_S) + 2, len(channels))
    rng = np.random.default_rng(1)
    with Writer(path, text, Session(start_ns=START_NS)) as writer:
        for second in track(range(seconds), "writing", console=console):
            number = second * RATE + np.arange(RATE)
            pose, phase = np.divmod(number / RATE, POSE_S)
            gone = 0.5 - 0.5 * np.cos(np.pi * np.clip(phase / MOVE_S, 0, 1))
            for c, channel in enumerate(channels):
                start, goal = (rest[pose.astype(int) + k, c] for k in (0, 1))
                counts = channel.zero_count + start + (goal - start) * gone
                raw = np.rint(counts + rng.normal(0, NOISE, RATE)).astype(np.int64)
                device_ns = number * (10**9 // RATE)
                late_ns = rng.integers(200_000, 700_000, RATE)
                time_ns = START_NS + device_ns + late_ns
                writer.write_readings(channel.name, time_ns, raw, device_ns, number % 2**32)


def read(path: Path) -> None:
    """What a solve does first, with its cost, as JSON."""
    began, spent = time.perf_counter(), time.process_time()
    recording = read_recording(path)
    read_s = time.perf_counter() - began
    read_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    table = average(recording)
    took_s = time.perf_counter() - began
    zero = np.array([channel.zero_count for channel in recording.rig.channels])
    number = [
        round(((w.start_ns + w.end_ns) / 2 - START_NS) / 1e9 / POSE_S - 0.7) for w in table.windows
    ]
    error = table.counts - zero - levels(max(number) + 2, len(zero))[np.array(number) + 1]
    found = {
        "readings": sum(map(len, recording.readings.values())),
        "dwells": len(table.windows),
        "read_s": read_s,
        "read_gib": read_gib,
        "average_s": took_s - read_s,
        "all_s": took_s,
        "processor_s": time.process_time() - spent,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "worst_error_se": float(np.abs(error / table.sigma).max()),
    }
    sys.stdout.write(json.dumps(found))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=3600, help="length of the recording")
    parser.add_argument("--keep", metavar="FILE", type=Path, help="keep or reuse the recording")
    parser.add_argument("--read", metavar="FILE", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.read is not None:
        read(given.read)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = given.keep or Path(folder) / "hour.mcap"
        if not path.exists():
            write(path, given.seconds)
        megabytes = path.stat().st_size / 1e6
        answer = subprocess.run(
            [sys.executable, __file__, "--read", str(path)], stdout=subprocess.PIPE, check=True
        )
    found = json.loads(answer.stdout)
    table = Table("", "", title=f"{found['readings']:,} readings, {megabytes:.0f} MB")
    table.add_row("reading", f"{found['read_s']:.1f} s, peak {found['read_gib']:.2f} GiB")
    table.add_row("dwells found and averaged", f"{found['average_s']:.1f} s")
    table.add_row("together", f"{found['all_s']:.1f} s, processor {found['processor_s']:.1f} s")
    table.add_row("peak memory of the process", f"{found['peak_gib']:.2f} GiB")
    table.add_row("dwells; worst mean", f"{found['dwells']}; {found['worst_error_se']:.1f} σ off")
    console.print(table)
    met = found["all_s"] <= LONGEST_S and found["peak_gib"] <= MOST_GIB
    whole = found["dwells"] >= given.seconds // POSE_S - 1 and found["worst_error_se"] < 6
    return 0 if met and whole else 1


if __name__ == "__main__":
    sys.exit(main())
