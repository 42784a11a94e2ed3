"""`loopcal sim`: nature and the virtual devices of a rig, with their faults, until they are stopped."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from loopcal.console import err, fail, out
from recordings.rig import load_rig
from sim_devices.bench import run_bench, stop_on_signals
from sim_devices.faults import Injector
from sim_devices.faults.live import LiveLines
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant
from sim_devices.truth import write_truth


def run_sim(
    name: str,
    ports: Mapping[str, str],
    hide: Sequence[str],
    seed: int,
    truth: Path | None,
    *,
    script: Path | None,
    live: bool,
) -> None:
    """Run the bench in the foreground; says where its ports are as soon as they can be opened.

    The truth is written then too: a bench that cannot run leaves no file behind.

    Faults are those of ``script``, and with ``live`` those of the lines of the standard input;
    each is printed when it happens.
    """
    rig = load_rig(name)
    faults = Injector(rig, "" if script is None else _read(script), _say_fault)
    lines = LiveLines(sys.stdin.fileno(), faults, _say_error) if live else None
    nature = make_nature(rig, seed, hide)
    plant = make_plant(nature)

    def ready(addresses: Mapping[str, str]) -> None:
        if truth is not None:
            write_truth(nature.truth, truth)
        for port, address in addresses.items():
            out.print(f"{port} at {address}", markup=False, soft_wrap=True)
        if live:
            out.print("faults can be typed, such as: silence NAME for 2 s", markup=False)
        out.print("ready; Ctrl-C ends it", markup=False)
        out.file.flush()

    with stop_on_signals() as stop:
        run_bench(
            rig,
            plant,
            stop=stop,
            ports=ports,
            ready=ready,
            faults=faults,
            seed=seed,
            each_tick=lines.poll if lines else None,
        )


def _say_fault(time_s: float, text: str) -> None:
    out.print(f"{time_s:.2f} s: {text}", markup=False, soft_wrap=True)
    out.file.flush()


def _say_error(message: str) -> None:
    err.print(f"loopcal: {message}", style="red", markup=False, soft_wrap=True)


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        fail(f"cannot read the fault script '{path}': {error}")
