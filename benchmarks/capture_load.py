"""Four saturated CAN buses and two serial converters recorded at once:

    python benchmarks/capture_load.py [--seconds 60] [--rate 9000]
    python benchmarks/capture_load.py --minutes 10 --faults --rate 1000      (soak)

A feeder in a process of its own (`bus_feeder.py`) writes slcan frames to four pseudo-terminals,
three encoders a bus, and answers Modbus reads on two more; `daq.capture` records them by the
drivers dbc-encoder and modbus-adc, while its live state is read five times a second. Like a real
adapter the feeder does not wait for a slow reader: what finds no room is lost, and counted by it.

Printed: what came, latency from the write to the arrival stamp, processor time, memory, threads.
Then every frame is accounted for, by the numbers in the frames: those that are missing in the
file must be those that the feeder could not deliver or spoilt, and the ledger must say as many.
Ends with exit code 1 where one is not, or where memory or threads grow.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from monte_carlo import console
from numpy.typing import NDArray
from rich.progress import Progress as Bar
from rich.table import Table

from daq import CaptureOptions, CaptureSummary, Progress, capture
from daq.clock import HostClock
from drivers import make_links
from recordings.reader import read_recording
from recordings.recording import Recording
from recordings.rig import parse_rig

BUSES, ENCODERS, CONVERTERS = 4, 3, 2
POLL_HZ = 100
IDENTIFIERS = tuple(0x181 + place for place in range(ENCODERS))
MOST_GROWTH_MB = 20.0

DBC = 'VERSION ""\\nNS_ :\\nBS_:\\nBU_: X\\n' + "".join(
    f'BO_ {identifier} Enc{place}: 8 X\\n SG_ Number : 0|32@1+ (1,0) [0|0] "" X\\n'
    f' SG_ Sent : 32|32@1+ (1,0) [0|0] "us" X\\n'
    for place, identifier in enumerate(IDENTIFIERS)
)


def rig_toml(folder: Path) -> str:
    """A rig of as many joints as there are sensors."""
    lines = [
        "schema = 1",
        'name = "load"',
        "[plan]",
        'mode = "by-hand"',
        f"sample_hz = {POLL_HZ}",
        "poses = 1",
        "[files]",
        f'"load.dbc" = """{DBC}"""'.replace("\\n", "\n").replace('""\n', '""\n', 1),
        "[mechanism]",
        'family = "serial"',
    ]
    channels: list[str] = []
    for bus in range(BUSES):
        name = f"can{bus}"
        lines += ["[[port]]", 'kind = "can"', f'name = "{name}"', 'interface = "slcan"']
        lines += [f'channel = "{folder / name}"', "bitrate = 1000000", "listen_only = true"]
        lines += ["[[device]]", f'name = "bus{bus}"', 'driver = "dbc-encoder"', f'port = "{name}"']
        lines += ['file = "load.dbc"', 'options = { counter = "Number" }']
        for place in range(ENCODERS):
            channels += ["[[channel]]", f'name = "b{bus}e{place}"', f'senses = "jb{bus}e{place}"']
            channels += [f'device = "bus{bus}"', f'signal = "Enc{place}.Sent"']
            channels += ["gain_deg_per_count = 0.001"]
    for number in range(CONVERTERS):
        name = f"adc{number}"
        lines += ["[[port]]", 'kind = "serial"', f'name = "{name}"', f'path = "{folder / name}"']
        lines += ["baudrate = 921600"]
        lines += ["[[device]]", f'name = "conv{number}"', 'driver = "modbus-adc"']
        lines += [f'port = "{name}"', "[device.options]", f"unit_id = {number + 1}"]
        lines += ["counter_register = 0", 'counter_counts = "reads"']
        lines += ["first_register = 1", "channels = 1"]
        channels += ["[[channel]]", f'name = "a{number}"', f'senses = "ja{number}"']
        channels += [f'device = "conv{number}"', "signal = 0", "gain_deg_per_count = 0.001"]
    names = [f"b{b}e{e}" for b in range(BUSES) for e in range(ENCODERS)]
    names += [f"a{number}" for number in range(CONVERTERS)]
    for name in names:
        channels += ["[[mechanism.joint]]", f'name = "j{name}"']
    return "\n".join(lines + channels)


@dataclass
class Watch:
    """Memory and threads of this process while it records."""

    at_s: list[float] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)

    def take(self) -> None:
        """Look once."""
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.at_s.append(time.monotonic())
        self.memory_mb.append(pages * resource.getpagesize() / 1e6)
        self.threads.append(threading.active_count())

    def grown_mb(self) -> float:
        """Median of the last quarter less that of the second."""
        quarter = max(len(self.memory_mb) // 4, 1)
        early, late = self.memory_mb[quarter : 2 * quarter], self.memory_mb[-quarter:]
        return float(np.median(late) - np.median(early or late))

    def more_threads(self) -> int:
        """Threads at the end beyond those after the first quarter."""
        return self.threads[-1] - max(self.threads[: max(len(self.threads) // 4, 1)])


def task(folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    """What the feeder is to do."""
    ports: list[dict[str, Any]] = [
        {"name": f"can{bus}", "identifiers": IDENTIFIERS, "rate": given.rate}
        for bus in range(BUSES)
    ]
    ports += [{"name": f"adc{number}", "unit": number + 1} for number in range(CONVERTERS)]
    return {"folder": str(folder), "ports": ports, "faults": given.faults, "seed": given.seed}


def latencies_ms(recording: Recording, anchor_ns: int) -> NDArray[np.float64]:
    """From the write of a frame to its arrival stamp, of all CAN channels."""
    out = []
    for name, readings in recording.readings.items():
        if name.startswith("b"):
            arrived_us = (readings.time_ns - anchor_ns) // 1000
            out.append((arrived_us - readings.raw) % 2**32)
    return np.concatenate(out) / 1e3


def accounted(
    recording: Recording, summary: CaptureSummary, account: dict[str, Any]
) -> tuple[int, int, int]:
    """Frames missing within each channel's first to last, those nobody explains, ledgers that are off."""
    missing = unexplained = off = 0
    for bus in range(BUSES):
        lost = account["ports"][f"can{bus}"]["lost"]
        known = {number for numbers in lost.values() for number in numbers}
        away = set(lost["unplugged"])
        for place in range(ENCODERS):
            name = f"b{bus}e{place}"
            found = recording.readings[name].sequence
            assert found is not None
            numbers = found.astype(np.int64)
            gone = np.setdiff1d(np.arange(numbers[0], numbers[-1] + 1), numbers)
            missing += len(gone)
            for run in np.split(gone, np.flatnonzero(np.diff(gone) > 1) + 1):
                frames = (run * ENCODERS + place).tolist()
                # Frames that nobody had read went with the terminal, or lay there before it was opened.
                if away.isdisjoint(frames):
                    unexplained += sum(number not in known for number in frames)
            entry = summary.ledger[name]
            said = entry.dropped_by_device + entry.dropped_by_host + entry.lost_in_gaps
            right = entry.unaccounted == 0 and entry.received == len(numbers) and said == len(gone)
            off += not right
            if not right:
                console.print(f"{name}: {len(gone)} missing, ledger {entry}")
    for number in range(CONVERTERS):
        name = f"a{number}"
        entry = summary.ledger[name]
        right = entry.unaccounted == 0 and entry.received == len(recording.readings[name])
        off += not right
        if not right:
            console.print(f"{name}: {len(recording.readings[name])} recorded, ledger {entry}")
    return missing, unexplained, off


def run(folder: Path, given: argparse.Namespace, seconds: float) -> bool:
    """One session; whether all is accounted for and nothing grows."""
    text = rig_toml(folder)
    rig = parse_rig(text)
    clock = HostClock()
    anchor_ns = clock.now_ns() - time.monotonic_ns()
    feeder = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("bus_feeder.py"))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert feeder.stdin is not None
    assert feeder.stdout is not None
    feeder.stdin.write(json.dumps(task(folder, given)) + "\n")
    feeder.stdin.flush()
    if feeder.stdout.readline() != "ready\n":
        raise SystemExit("the feeder did not start")
    watch = Watch()
    output = folder / "load.mcap"
    with Bar(console=console, transient=True) as bar:
        shown = bar.add_task("recording", total=seconds)
        began, spent = time.monotonic(), time.process_time()

        def show(progress: Progress) -> None:
            watch.take()
            bar.update(shown, completed=time.monotonic() - began)

        summary = capture(
            rig,
            text,
            output,
            links=make_links(rig, clock),
            clock=clock,
            on_progress=show,
            options=CaptureOptions(max_duration_s=seconds),
        )
        took_s, spent_s = time.monotonic() - began, time.process_time() - spent
    answer, _ = feeder.communicate()
    account = json.loads(answer)
    recording = read_recording(output)
    return report(recording, summary, account, watch, (took_s, spent_s, anchor_ns), given)


def report(
    recording: Recording,
    summary: CaptureSummary,
    account: dict[str, Any],
    watch: Watch,
    times: tuple[float, float, int],
    given: argparse.Namespace,
) -> bool:
    """Print what was measured; whether all is well."""
    took_s, spent_s, anchor_ns = times
    frames = sum(len(r) for name, r in recording.readings.items() if name.startswith("b"))
    polled = sum(len(r) for name, r in recording.readings.items() if name.startswith("a"))
    missing, unexplained, off = accounted(recording, summary, account)
    buses = [each for each in account["ports"].values() if "lost" in each]
    lost = {kind: sum(len(each["lost"][kind]) for each in buses) for kind in buses[0]["lost"]}
    late = latencies_ms(recording, anchor_ns)
    median, p99, worst = np.percentile(late, [50, 99, 100])
    dropped = sum(e.dropped_by_host for n, e in summary.ledger.items() if n.startswith("b"))
    table = Table("", "", title=f"{summary.duration_s:.0f} s, {summary.ending}")
    table.add_row(
        "frames offered", f"{sum(each['sent'] for each in buses):,} ({BUSES} x {given.rate}/s)"
    )
    table.add_row("frames recorded", f"{frames:,} ({frames / summary.duration_s:,.0f}/s)")
    table.add_row("Modbus readings recorded", f"{polled:,}")
    table.add_row(
        "latency to the arrival stamp", f"median {median:.1f}, p99 {p99:.1f}, worst {worst:.0f} ms"
    )
    table.add_row(
        "processor", f"{spent_s / took_s:.2f} cores; feeder {account['processor_s'] / took_s:.2f}"
    )
    table.add_row(
        "memory", f"{max(watch.memory_mb):.0f} MB at most, grown by {watch.grown_mb():.1f} MB"
    )
    table.add_row("threads", f"{max(watch.threads)} at most, {watch.more_threads():+d} in the end")
    table.add_row(
        "not delivered by the feeder", ", ".join(f"{n:,} {kind}" for kind, n in lost.items())
    )
    table.add_row("faults injected", str(sum(each["faults"] for each in buses)))
    table.add_row("frames refused by the queue (in the ledger)", f"{dropped:,}")
    table.add_row(
        "missing in the file", f"{missing:,}, of them unexplained {unexplained - dropped:,}"
    )
    table.add_row("channels whose ledger is off", str(off))
    console.print(table)
    grown = watch.grown_mb() > MOST_GROWTH_MB or watch.more_threads() > 0
    return not (off or unexplained != dropped or grown or summary.error)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--minutes", type=float, help="in place of --seconds")
    parser.add_argument("--rate", type=int, default=9000, help="frames a second on each bus")
    parser.add_argument(
        "--faults", action="store_true", help="unplug buses, garble and drop frames"
    )
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    seconds = given.seconds if given.minutes is None else 60 * given.minutes
    with tempfile.TemporaryDirectory() as folder:
        return 0 if run(Path(folder), given, seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
