"""Effects at a live bench: what the devices sense is what a played session shows."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parameters, parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant
from sim_devices.plant.tour import counts_for


def bench(name, wishes):
    text, source = rig_text(name)
    rig = parse_rig(text, source)
    nature = make_nature(rig, 1, wishes, poses=5)
    return rig, nature, make_plant(nature)


def go(rig, plant, targets, start_s, end_s):
    """Send the drives of the arm off, and let time pass."""
    nominal = {p.name: p.nominal for p in parameters(rig)}
    for joint, target in targets.items():
        channel = rig.sensed_by(joint)
        plant.command(joint, "position", counts_for(channel, nominal, np.deg2rad(target)))
    for time_s in np.arange(start_s, end_s, 0.02):
        plant.advance(time_s)


@pytest.mark.parametrize(
    "wish",
    ["joint-compliance@joint6=0.05", "bearing-compliance@joint2=0.02", "fixture-compliance@fixture=2e-5", "fixture-slip@fixture=2e-3",
     "thermal-growth@links=1e-4", "outsider:wobbling-axis@joint3=0.2"],
)  # fmt: skip
def test_the_loop_closes_with_the_effect_whatever_moves(wish):
    rig, nature, plant = bench("arm", [wish])
    plant.advance(0.0)
    go(rig, plant, {"joint5": 61.0, "joint6": -12.0}, 0.02, 0.1)
    go(rig, plant, {"joint5": 65.0, "joint6": 5.0}, 0.1, 1.0)
    for time_s in (1.0, 13.0, 13.02):
        plant.advance(time_s)
        here = plant.variables[None]
        error, _ = nature.mechanism.closure(here, np.array([time_s]))
        assert np.abs(error).max() < 1e-9
        assert not any(plant.drive_fault(joint) for joint in rig.plan.drives)
        assert np.rad2deg(here[0, 5]) == pytest.approx(65.0, abs=1e-3)
    bare = make_nature(rig, 1).mechanism.closure(here, np.array([13.02]))[0]
    assert np.abs(bare).max() > 1e-5


def test_backlash_is_remembered_between_readings():
    rig, _, plant = bench("arm", ["backlash@q6=2"])
    plant.advance(0.0)
    go(rig, plant, {"joint5": 61.0, "joint6": -12.0}, 0.02, 0.1)
    seen = []
    start_s = 0.1
    for target in (0.0, 10.0, 0.0):
        for end_s in np.arange(start_s + 0.1, start_s + 1.0, 0.1):
            go(rig, plant, {"joint6": target}, end_s - 0.1, end_s)
            plant.sense("q6")
        start_s += 1.0
        seen.append(np.mean([plant.sense("q6") for _ in range(50)]) * 0.0439453125)
    up, _, down = seen
    assert down - up == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    ("name", "wish"),
    [
        ("shoulder", "thermal-growth@links=1e-4"),
        ("shoulder", "fixture-slip@fixture=3e-3"),
        ("shoulder", "joint-compliance@leg2=1e-4"),
        ("shoulder", "lag@d2=0.02"),
        ("shoulder", "crosstalk@d2<-d1=20%"),
        ("shoulder", "stuck-bit@d2=2e-3"),
        ("arm", "offset-drift@q7=0.02"),
    ],
)
def test_devices_sense_the_effect(name, wish):
    rig, _, plant = bench(name, [wish])
    _, _, plain = bench(name, [])
    apart = 0
    for time_s in np.linspace(0.0, 150.0, 60):
        plant.advance(time_s)
        plain.advance(time_s)
        for channel in rig.channels:
            one, other = plant.sense(channel.name), plain.sense(channel.name)
            apart = max(apart, abs(one - other))
    assert apart > 10
