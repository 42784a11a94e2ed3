"""When faults begin and end, and that overlapping ones leave nothing behind."""

from __future__ import annotations

import os

import pytest

from recordings.rig import load_rig
from sim_devices.faults import Injector, Order, ScriptError
from sim_devices.faults.injector import Active
from sim_devices.faults.live import LiveLines


class Wires:
    """Notes what is done to it."""

    def __init__(self) -> None:
        self.once: list[tuple[str, str, bool]] = []
        self.active: set[str] = set()

    def happen(self, order: Order, time_s: float) -> None:
        self.once.append((order.fault.verb, order.target, order.ends))

    def disturb(self, active: Active) -> None:
        self.active = {f"{verb} {target}" for verb, target in active}


@pytest.fixture
def wires() -> Wires:
    return Wires()


def bound(wires: Wires, script: str = "", **options) -> Injector:
    faults = Injector(load_rig("arm"), script, **options)
    faults.bind(wires)
    return faults


def test_a_fault_begins_at_its_time_and_ends_after_its_duration(wires) -> None:
    said: list[tuple[float, str]] = []
    script = "at 3 s silence encoder3 for 2 s"
    faults = bound(wires, script, on_event=lambda time_s, text: said.append((time_s, text)))
    seen = []
    for tick in range(60):
        faults.advance(tick / 10)
        seen.append(wires.active == {"silence encoder3"})
    assert seen == [30 <= tick < 50 for tick in range(60)]
    assert said == [(3.0, "silence encoder3 for 2 s"), (5.0, "end silence encoder3")]
    assert faults.active == ()


def test_what_has_no_duration_lasts_until_it_is_ended(wires) -> None:
    faults = bound(wires, "unplug wrist-adc\nat 9 s replug wrist-adc")
    faults.advance(0.0)
    faults.advance(8.9)
    assert wires.active == {"unplug wrist-adc"}
    faults.advance(9.0)
    assert wires.active == set()


def test_a_fault_begun_again_ends_with_the_later_one(wires) -> None:
    faults = bound(wires, "at 1 s silence encoder3 for 2 s\nat 2 s silence encoder3 for 3 s")
    for time_s, there in ((1.5, True), (3.5, True), (4.9, True), (5.0, False)):
        faults.advance(time_s)
        assert bool(wires.active) is there


def test_the_end_of_one_fault_is_not_the_end_of_another(wires) -> None:
    faults = bound(wires, "at 1 s silence encoder3 for 1 s\nat 1 s silence arm-can for 3 s")
    faults.advance(1.0)
    assert wires.active == {"silence encoder3", "silence arm-can"}
    faults.advance(2.0)
    assert wires.active == {"silence arm-can"}


def test_a_held_up_bench_does_everything_in_order(wires) -> None:
    faults = bound(
        wires, "at 1 s restart drive1\nat 2 s silence encoder1 for 1 s\nat 4 s restart drive2"
    )
    faults.advance(10.0)
    assert wires.once == [
        ("restart", "drive1", False),
        ("silence", "encoder1", False),
        ("silence", "encoder1", True),
        ("restart", "drive2", False),
    ]
    assert wires.active == set()


def test_an_end_of_what_has_not_begun_is_nothing(wires) -> None:
    faults = bound(wires, "end silence encoder1")
    faults.advance(1.0)
    assert wires.once == []


def test_lines_are_injected_now_or_at_their_time(wires) -> None:
    faults = bound(wires)
    faults.advance(5.0)
    faults.inject("silence encoder1 for 1 s")
    faults.inject("at 7 s restart drive1")
    faults.inject("# nothing")
    assert wires.active == set()
    faults.advance(5.005)
    assert wires.active == {"silence encoder1"}
    faults.advance(6.01)
    assert wires.active == set()
    faults.advance(7.0)
    assert wires.once[-1] == ("restart", "drive1", False)


def test_a_line_that_means_nothing_is_refused_at_once(wires) -> None:
    faults = bound(wires)
    with pytest.raises(ScriptError, match="did you mean 'encoder1'"):
        faults.inject("silence encoder11")
    faults.advance(1.0)
    assert wires.once == []


def test_live_lines_come_from_a_pipe_in_pieces(wires) -> None:
    faults = bound(wires)
    complaints: list[str] = []
    read, write = os.pipe()
    try:
        lines = LiveLines(read, faults, complaints.append)
        lines.poll()
        os.write(write, b"silence enc")
        lines.poll()
        faults.advance(1.0)
        assert wires.active == set()
        os.write(write, b"oder1\nhush encoder2\nsilence encoder2")
        lines.poll()
        faults.advance(2.0)
        assert wires.active == {"silence encoder1"}
        assert "expected a fault" in complaints[0]
    finally:
        os.close(write)
    lines.poll()
    lines.poll()
    faults.advance(3.0)
    assert wires.active == {"silence encoder1", "silence encoder2"}
    os.close(read)
