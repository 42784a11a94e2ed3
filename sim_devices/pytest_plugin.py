"""Fixtures for the tests of whoever uses loopcal: virtual rigs, their faults, and virtual time.

Installed with loopcal and found by pytest as an entry point. Nothing is imported before a
fixture is used, and no setting of pytest is touched. How to use it: ``docs/howto-pytest.md``.

Fixtures:
    loopcal_rig: runs a rig's virtual devices on real ports (pseudo-terminals) of the test's own.
    loopcal_memory_rig: the same in memory and by virtual time, for tests without waiting.
    loopcal_clock: that virtual time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import pytest

if TYPE_CHECKING:
    from recordings.rig import Rig
    from sim_devices.in_memory import MemoryBench
    from sim_devices.plant_seam import Plant
    from sim_devices.running import RunningBench
    from sim_devices.virtual_time import VirtualClock


class StartRig(Protocol):
    """What `loopcal_rig` gives: a function that starts a bench, which ends with the test."""

    def __call__(
        self,
        rig: Rig | str | Path = "arm",
        *,
        faults: str = "",
        hide: Sequence[str] = (),
        seed: int = 1,
        plant: Plant | None = None,
    ) -> RunningBench:
        """Start the virtual devices of a rig.

        Args:
            rig: a rig, the path of a rig file, or the name of a bundled rig.
            faults: fault script.
            hide: effects to hide in nature, as ``loopcal sim --hide`` takes them.
            seed: of all that is random.
            plant: nature, in place of the rig's own.
        """


class StartMemoryRig(Protocol):
    """What `loopcal_memory_rig` gives: the same, in memory."""

    def __call__(
        self,
        rig: Rig | str | Path = "arm",
        *,
        faults: str = "",
        hide: Sequence[str] = (),
        seed: int = 1,
        plant: Plant | None = None,
    ) -> MemoryBench:
        """Start the virtual devices of a rig; the arguments are those of `StartRig`."""


@pytest.fixture
def loopcal_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartRig]:
    """Starts virtual rigs on pseudo-terminals; they end with the test, and leave nothing behind."""
    from sim_devices.running import running

    with ExitStack() as benches:

        def start(
            rig: Rig | str | Path = "arm",
            *,
            faults: str = "",
            hide: Sequence[str] = (),
            seed: int = 1,
            plant: Plant | None = None,
        ) -> RunningBench:
            loaded = _load(rig)
            nature = plant or _nature(loaded, hide, seed)
            folder = tmp_path_factory.mktemp("loopcal-ports")
            return benches.enter_context(running(loaded, nature, folder, faults, seed))

        yield start


@pytest.fixture
def loopcal_clock() -> VirtualClock:
    """Time that passes only when it is advanced or waited for."""
    from sim_devices.virtual_time import VirtualClock

    return VirtualClock()


@pytest.fixture
def loopcal_memory_rig(loopcal_clock: VirtualClock) -> Iterator[StartMemoryRig]:
    """Starts virtual rigs in memory, by `loopcal_clock`; until the test ends, all time is virtual.

    `time.monotonic` and `time.sleep` go by that clock as long as a rig is running.
    """
    from sim_devices.faults import Injector
    from sim_devices.in_memory import MemoryBench

    with ExitStack() as benches:

        def start(
            rig: Rig | str | Path = "arm",
            *,
            faults: str = "",
            hide: Sequence[str] = (),
            seed: int = 1,
            plant: Plant | None = None,
        ) -> MemoryBench:
            loaded = _load(rig)
            nature = plant or _nature(loaded, hide, seed)
            bench = MemoryBench(loaded, nature, loopcal_clock, Injector(loaded, faults), seed)
            benches.enter_context(bench.running())
            return bench

        yield start


def _load(rig: Rig | str | Path) -> Rig:
    from recordings.rig import Rig, load_rig

    return rig if isinstance(rig, Rig) else load_rig(str(rig))


def _nature(rig: Rig, hide: Sequence[str], seed: int) -> Plant:
    from sim_devices.plant.creation import make_nature
    from sim_devices.plant.live import make_plant

    return make_plant(make_nature(rig, seed, hide))
