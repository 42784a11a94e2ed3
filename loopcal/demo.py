"""`loopcal demo`: both papers' mechanisms through the wires, from virtual devices to reports.

Runs the commands that a user would type, each in a process of its own: `sim` and `capture`
talk over pseudo-terminals like a bench and its host. Both sessions run at once.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from loopcal.console import fail, out
from loopcal.solving import read_truth, show, write_json
from recordings.reader import read_recording
from recordings.rig import load_rig
from solver.report.report import write_report
from solver.result import result
from solver.solve import solve

MECHANISMS = {"arm": 30, "shoulder": 30}
"""The bundled rigs, and how many of their poses are enough for a demonstration."""

_SEED = 7
_STOP_S = 10.0
_STOPS = re.compile(r"(\d+) of (\d+) stops")


def run_demo(folder: Path) -> None:
    """Capture both mechanisms, solve, report, and show the truth beside the estimate."""
    began = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    out.print(
        "Virtual devices on pseudo-terminals, captured over CANopen and Modbus RTU:", style="bold"
    )
    bar = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=out)
    with tempfile.TemporaryDirectory(prefix="loopcal-demo-") as wires, ExitStack() as benches, bar:
        captures = []
        for name in MECHANISMS:
            for old in (_recording(folder, name), _truth(folder, name)):
                old.unlink(missing_ok=True)
            ports = [f"--port={port.name}={wires}/{port.name}" for port in load_rig(name).ports]
            benches.callback(_stop, _start_bench(name, ports, _truth(folder, name)))
            task = bar.add_task(f"capturing the {name}", total=None)
            capture = _Capture(name, ports, _recording(folder, name), bar, task)
            benches.callback(capture.end)
            captures.append(capture)
        for capture in captures:
            capture.finish()
    for name in MECHANISMS:
        _solve(name, folder)
    out.print(f"\nDone in {time.monotonic() - began:.0f} s. The reports:", style="bold")
    for name in MECHANISMS:
        out.print(f"  {(folder / f'{name}.html').resolve()}", markup=False, soft_wrap=True)


def _recording(folder: Path, name: str) -> Path:
    return folder / f"{name}.mcap"


def _truth(folder: Path, name: str) -> Path:
    return folder / f"{name}.truth.json"


def _command(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "loopcal", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        # Ctrl-C is for the demo alone: it then stops captures before the devices they talk to.
        start_new_session=True,
        text=True,
    )


def _start_bench(name: str, ports: list[str], truth: Path) -> subprocess.Popen[str]:
    """The rig's virtual devices, ready to be opened."""
    bench = _command("sim", name, *ports, f"--seed={_SEED}", f"--truth={truth}")
    said = []
    for line in bench.stdout or ():
        if line.startswith("ready"):
            return bench
        said.append(line)
    return fail(f"the virtual devices of the {name} did not start:\n{''.join(said)}")


def _stop(bench: subprocess.Popen[str]) -> None:
    bench.terminate()
    bench.communicate(timeout=_STOP_S)


class _Capture:
    """A capture session in a process of its own, shown on a bar."""

    def __init__(
        self, name: str, ports: list[str], path: Path, bar: Progress, task: TaskID
    ) -> None:
        self._name, self._bar, self._task = name, bar, task
        self._process = _command(
            "capture",
            name,
            *ports,
            f"--output={path}",
            "--operator=demo",
            f"--poses={MECHANISMS[name]}",
        )
        self._said: list[str] = []
        self._reader = threading.Thread(target=self._follow, name=f"capture {name}")
        self._reader.start()

    def _follow(self) -> None:
        for line in self._process.stdout or ():
            self._said.append(line)
            if found := _STOPS.match(line):
                self._bar.update(self._task, completed=int(found[1]), total=int(found[2]))

    def end(self) -> None:
        """Stop the session if it is still running."""
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait(_STOP_S)
        self._reader.join()

    def finish(self) -> None:
        """Wait for the end, and show how it went."""
        self._reader.join()
        if self._process.wait() != 0:
            fail(f"the capture of the {self._name} failed:\n{''.join(self._said)}")
        self._bar.update(self._task, completed=1, total=1)


def _solve(name: str, folder: Path) -> None:
    """Solve one recording; report, result file, and the truth beside the estimate."""
    recording = read_recording(_recording(folder, name))
    truth = read_truth(_truth(folder, name))
    out.print(
        f"\n{recording.rig.title}: the truth that the virtual devices hid, found again",
        style="bold",
    )
    lost = sum(entry.expected - entry.received for entry in recording.ledger.values())
    received = sum(entry.received for entry in recording.ledger.values())
    out.print(f"{received} readings recorded, {lost} lost", markup=False)
    with out.status("solving"):
        solution = solve(recording)
        write_json(result(solution), folder / f"{name}.json")
    with out.status("writing the report"):
        write_report(
            solution, folder / f"{name}.html", truth=truth, recording=recording, overwrite=True
        )
    show(solution, truth)
