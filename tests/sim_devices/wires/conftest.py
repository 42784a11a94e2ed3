"""A plant that a test sets, rigs with ports of the test's own, benches that run beside a test."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from recordings.rig import Rig, load_rig, parse_rig, rig_text
from sim_devices.running import running as run_beside
from tests.sim_devices.wires.echo import EchoLine


@dataclass
class FakePlant:
    """Nature that only does what a test tells it."""

    counts: dict[str, int] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)
    commands: list[tuple[str, str, int]] = field(default_factory=list)
    time_s: float = 0.0

    def advance(self, time_s: float) -> None:
        assert time_s >= self.time_s
        self.time_s = time_s

    def sense(self, channel: str) -> int:
        return self.counts.get(channel, 0)

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        self.commands.append((joint, mode, target_raw))

    def drive_fault(self, joint: str) -> int:
        return self.faults.get(joint, 0)


@pytest.fixture
def plant() -> FakePlant:
    return FakePlant()


@pytest.fixture
def arm() -> Rig:
    return load_rig("arm")


@pytest.fixture
def line() -> EchoLine:
    return EchoLine()


def rig_in(folder: Path, name: str) -> Rig:
    """A bundled rig whose ports lie in ``folder``."""
    return parse_rig(rig_text(name)[0].replace("/tmp/", f"{folder}/"))


@pytest.fixture
def arm_here(tmp_path: Path) -> Rig:
    return rig_in(tmp_path, "arm")


@pytest.fixture
def shoulder_here(tmp_path: Path) -> Rig:
    return rig_in(tmp_path, "shoulder")


Running = Callable[[Rig, FakePlant], "contextlib.AbstractContextManager[Mapping[str, str]]"]


@contextlib.contextmanager
def _running(rig: Rig, plant: FakePlant) -> Iterator[Mapping[str, str]]:
    with run_beside(rig, plant, folder=None) as bench:
        yield bench.ports


@pytest.fixture
def running() -> Running:
    """Runs a bench in a thread for the length of a ``with`` block; gives port addresses."""
    return _running


@pytest.fixture
def no_leaks() -> Iterator[None]:
    """Fails a test that leaves a thread or a descriptor behind."""
    gc.collect()
    threads, descriptors = threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))
    yield
    gc.collect()
    assert threading.active_count() <= threads, threading.enumerate()
    assert len(list(Path("/proc/self/fd").iterdir())) <= descriptors
