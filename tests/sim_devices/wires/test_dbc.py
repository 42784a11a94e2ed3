"""The virtual devices of a DBC: what they send, what they obey, and when a drive trips by itself."""

from __future__ import annotations

import cantools
import pytest

from recordings.rig import Rig
from sim_devices.can_bus import CanBus, Frame
from sim_devices.kinds import can_bus
from tests.drivers.families import DBC, FAMILIES

THEIRS = cantools.database.load_string(DBC, "dbc")


@pytest.fixture
def rig() -> Rig:
    return FAMILIES["dbc"].rig


@pytest.fixture
def bus(rig: Rig, plant) -> CanBus:
    plant.counts = {"q1": -4000, "q2": 70_000}
    return can_bus(rig, rig.ports[0], plant)


def said(frames: list[Frame], name: str) -> list[dict]:
    message = THEIRS.get_message_by_name(name)
    return [
        message.decode(frame.data, decode_choices=False, scaling=False)
        for frame in frames
        if (frame.identifier, frame.extended) == (message.frame_id, message.is_extended_frame)
    ]


def command(mode: int, target: int = 0, torque: int = 0) -> Frame:
    values = {"Mode": mode, "Key": 0, "Count": 0, "Target": target, "Torque": torque}
    data = THEIRS.get_message_by_name("DriveCommand").encode(values, scaling=False)
    return Frame(600, data)


def run(bus: CanBus, begin_s: float, end_s: float) -> list[Frame]:
    steps = round((end_s - begin_s) / 0.005)
    return [frame for k in range(steps) for frame in bus.tick(begin_s + 0.005 * k)]


def test_sensors_send_every_cycle_with_counter_and_time(bus: CanBus) -> None:
    frames = run(bus, 0.0, 1.0)
    positions = said(frames, "ElbowPosition")
    assert len(positions) in (100, 101)
    assert {p["Angle"] for p in positions} == {-4000}
    assert [p["Count"] for p in positions] == [k % 256 for k in range(len(positions))]
    assert 975 <= positions[-1]["Time"] <= 1000
    pages = said(frames, "Multiplexed")
    assert {(p["Page"], p["Wrist"]) for p in pages} == {(0, 70_000)}


def test_a_drive_obeys_and_shows_it(bus: CanBus, plant) -> None:
    for step, (mode, target, torque, told) in enumerate(
        (
            (1, 0, 0, ("joint1", "free", 0)),
            (2, 5100, 0, ("joint1", "position", 2500)),
            (3, 0, -30, ("joint1", "torque", -30)),
            (0, 0, 0, ("joint1", "off", 0)),
        )
    ):
        bus.receive(command(mode, target, torque), 0.1 * step)
        assert plant.commands[-1] == told
        status = said(run(bus, 0.1 * step, 0.1 * (step + 1)), "DriveStatus")[-1]
        assert (status["Shown"], status["Error"]) == (mode, 0)
        assert status["Actual"] == 2 * -4000 + 100


def test_a_drive_that_hears_nothing_trips_and_off_acknowledges(bus: CanBus, plant) -> None:
    bus.receive(command(1), 0.0)
    assert said(run(bus, 0.0, 0.9), "DriveStatus")[-1]["Error"] == 0
    assert said(run(bus, 0.9, 1.2), "DriveStatus")[-1]["Error"] == 1
    assert plant.commands[-1] == ("joint1", "off", 0)
    bus.receive(command(1), 1.2)
    assert said(run(bus, 1.2, 1.3), "DriveStatus")[-1]["Error"] == 1
    bus.receive(command(0), 1.3)
    bus.receive(command(1), 1.3)
    assert said(run(bus, 1.3, 1.4), "DriveStatus")[-1] == {"Shown": 1, "Error": 0, "Actual": -7900}


def test_a_fault_of_the_plant_is_the_drives(bus: CanBus, plant) -> None:
    plant.faults["joint1"] = 0x8611
    assert said(run(bus, 0.0, 0.1), "DriveStatus")[-1]["Error"] == 0x11
    bus.receive(command(0), 0.1)
    assert said(run(bus, 0.1, 0.2), "DriveStatus")[-1]["Error"] == 0x11
