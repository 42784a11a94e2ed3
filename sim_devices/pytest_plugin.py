"""Fixtures for the tests of whoever uses loopcal: virtual rigs, their faults, and virtual time.

Installed with loopcal and found by pytest as an entry point. Nothing is imported before a
fixture is used, and no setting of pytest is touched. How to use it: ``docs/howto-pytest.md``.

Fixtures:
    loopcal_rig: runs a rig's virtual devices on real ports (pseudo-terminals) of the test's own.
    loopcal_memory_rig: the same in memory and by virtual time, for tests without waiting.
    loopcal_clock: that virtual time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

import pytest

if TYPE_CHECKING:
    from recordings.rig import Rig
    from sim_devices.in_memory import MemoryBench
    from sim_devices.plant_seam import Plant
    from sim_devices.running import RunningBench
    from sim_devices.virtual_time import VirtualClock


Bench_co = TypeVar("Bench_co", covariant=True)


class StartRig(Protocol[Bench_co]):
    """A function that starts a bench, which ends with the test."""

    def __call__(
        self,
        rig: Rig | str | Path = "arm",
        *,
        faults: str = "",
        hide: Sequence[str] = (),
        seed: int = 1,
        plant: Plant | None = None,
    ) -> Bench_co:
        """Start the virtual devices of a rig.

        Args:
            rig: a rig, the path of a rig file, or the name of a bundled rig.
            faults: fault script.
            hide: effects to hide in nature, as ``loopcal sim --hide`` takes them.
            seed: of all that is random.
            plant: nature, in place of the rig's own.
        """


@pytest.fixture
def loopcal_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartRig[RunningBench]]:
    """Starts virtual rigs on pseudo-terminals; they end with the test, and leave nothing behind."""
    from sim_devices.running import running

    with ExitStack() as benches:

        def run(rig: Rig, plant: Plant, faults: str, seed: int) -> RunningBench:
            folder = tmp_path_factory.mktemp("loopcal-ports")
            return benches.enter_context(running(rig, plant, folder, faults, seed))

        yield _starting(run)


@pytest.fixture
def loopcal_clock() -> VirtualClock:
    """Time that passes only when it is advanced or waited for."""
    from sim_devices.virtual_time import VirtualClock

    return VirtualClock()


@pytest.fixture
def loopcal_memory_rig(loopcal_clock: VirtualClock) -> Iterator[StartRig[MemoryBench]]:
    """Starts virtual rigs in memory, by `loopcal_clock`; until the test ends, all time is virtual.

    `time.monotonic` and `time.sleep` go by that clock as long as a rig is running.
    """
    from sim_devices.faults import Injector
    from sim_devices.in_memory import MemoryBench

    with ExitStack() as benches:

        def run(rig: Rig, plant: Plant, faults: str, seed: int) -> MemoryBench:
            bench = MemoryBench(rig, plant, loopcal_clock, Injector(rig, faults), seed)
            benches.enter_context(bench.running())
            return bench

        yield _starting(run)


def _starting(run: Callable[[Rig, Plant, str, int], Bench_co]) -> StartRig[Bench_co]:
    """Starts benches by ``run``, which gets a rig, its nature, a fault script and a seed."""

    def start(
        rig: Rig | str | Path = "arm",
        *,
        faults: str = "",
        hide: Sequence[str] = (),
        seed: int = 1,
        plant: Plant | None = None,
    ) -> Bench_co:
        loaded = _load(rig)
        return run(loaded, plant or _nature(loaded, hide, seed), faults, seed)

    return start


def _load(rig: Rig | str | Path) -> Rig:
    from recordings.rig import Rig, load_rig

    return rig if isinstance(rig, Rig) else load_rig(str(rig))


def _nature(rig: Rig, hide: Sequence[str], seed: int) -> Plant:
    from sim_devices.plant.creation import make_nature
    from sim_devices.plant.live import make_plant

    return make_plant(make_nature(rig, seed, hide))
