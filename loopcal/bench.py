"""`loopcal sim`: nature and the virtual devices of a rig, running until they are stopped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from loopcal.console import out
from recordings.rig import load_rig
from sim_devices.bench import run_bench, stop_on_signals
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant
from sim_devices.truth import write_truth


def run_sim(
    name: str, ports: Mapping[str, str], hide: Sequence[str], seed: int, truth: Path | None
) -> None:
    """Run the bench in the foreground; says where its ports are as soon as they can be opened."""
    rig = load_rig(name)
    nature = make_nature(rig, seed, hide)
    plant = make_plant(nature)
    if truth is not None:
        write_truth(nature.truth, truth)

    def ready(addresses: Mapping[str, str]) -> None:
        for port, address in addresses.items():
            out.print(f"{port} at {address}", markup=False, soft_wrap=True)
        out.print("ready; Ctrl-C ends it", markup=False)
        out.file.flush()

    with stop_on_signals() as stop:
        run_bench(rig, plant, stop=stop, ports=ports, ready=ready)
