"""A bench in a thread beside the program that uses it: for tests, and for trying things out.

with running(load_rig("arm"), plant, folder) as bench:
    links = make_links(bench.rig, clock)
    bench.faults.inject("silence encoder3 for 1 s")
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from recordings.rig import CanPort, Rig, SerialPort, TcpPort
from sim_devices.bench import run_bench
from sim_devices.errors import SimDevicesError
from sim_devices.faults.injector import Injector
from sim_devices.moving import moved_rig
from sim_devices.plant_seam import Plant

PATIENCE_S = 20.0


class BenchStuck(SimDevicesError):
    """A bench did not come up, or did not end, within `PATIENCE_S`: a fault of this program."""


@dataclass(frozen=True, slots=True)
class RunningBench:
    """A bench that runs.

    Attributes:
        rig: the rig for the host: the same, with its ports where the bench is.
        ports: addresses by port name, as `drivers.make_links` and ``--port`` take them.
        faults: injects faults, from any thread.
        plant: nature behind the devices; it belongs to the bench's thread.
    """

    rig: Rig
    ports: Mapping[str, str]
    faults: Injector
    plant: Plant


@contextmanager
def running(
    rig: Rig,
    plant: Plant,
    folder: Path | None,
    script: str = "",
    seed: int = 0,
) -> Iterator[RunningBench]:
    """The virtual devices of ``rig`` on real ports, in a thread, as long as the block lasts.

    Args:
        rig: what to build. A CAN port in a folder is an slcan adapter, whatever its interface.
        plant: nature.
        folder: where the ports appear; empty again in the end. TCP ports listen on this computer.
            None leaves all of them where the rig has them.
        script: fault script.
        seed: of all that is random in faults.

    Raises:
        ScriptError: the script cannot be understood.
        SimDevicesError: whatever keeps a bench from starting, or ends it.
    """
    stop, up = threading.Event(), threading.Event()
    faults = Injector(rig, script)
    addresses: dict[str, str] = {}
    failures: list[BaseException] = []

    def ready(found: Mapping[str, str]) -> None:
        addresses.update(found)
        up.set()

    def run() -> None:
        try:
            paths = {} if folder is None else {p.name: _place(p, folder) for p in rig.ports}
            run_bench(rig, plant, stop=stop, ports=paths, ready=ready, faults=faults, seed=seed)
        except BaseException as error:  # noqa: BLE001 - raised again in the caller's thread
            failures.append(error)
        finally:
            up.set()

    thread = threading.Thread(target=run, name=f"loopcal-bench-{rig.name}")
    thread.start()
    try:
        if not up.wait(PATIENCE_S):
            raise BenchStuck(f"the bench of '{rig.name}' did not come up in {PATIENCE_S:g} s")
        if not failures:
            here = rig if folder is None else moved_rig(rig, addresses)
            yield RunningBench(here, addresses, faults, plant)
    finally:
        stop.set()
        thread.join(PATIENCE_S)
    if thread.is_alive():
        raise BenchStuck(f"the bench of '{rig.name}' did not end in {PATIENCE_S:g} s")
    if failures:
        raise failures[0]


def _place(port: CanPort | SerialPort | TcpPort, folder: Path) -> str:
    return "127.0.0.1:0" if isinstance(port, TcpPort) else str(folder / port.name)
