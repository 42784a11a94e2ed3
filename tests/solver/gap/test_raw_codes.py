"""Stuck bits and rails are read off raw codes, and healthy converters are left in peace."""

from __future__ import annotations

from pathlib import Path

import pytest

from recordings.reader import read_recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.raw_codes import CENSORED, censored, defects
from solver.samples import average


def recorded(path: Path, rig: str, seed: int, *hide: str):  # type: ignore[no-untyped-def]
    simulate(load_rig(rig), rig_text(rig)[0], path, seed=seed, hide=hide)
    return read_recording(path)


@pytest.mark.parametrize("rig", ["arm", "shoulder"])
def test_healthy_converters_show_nothing(tmp_path: Path, rig: str) -> None:
    recording = recorded(tmp_path / "r.mcap", rig, 3)
    assert defects(recording, average(recording)) == ()


def test_a_stuck_bit_far_below_the_noise_is_found(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r.mcap", "shoulder", 4, "stuck-bit@d3=0.0000586")
    (found,) = defects(recording, average(recording))
    assert (found.name, found.where, found.values["bit"].nominal) == ("stuck-bit", "d3", 1.0)


def test_a_rail_is_found_and_its_readings_are_worthless(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r.mcap", "arm", 5, "saturation@q6=4")
    table = average(recording)
    (found,) = defects(recording, table)
    assert (found.name, found.where) == ("saturation", "q6")
    grown = censored(table.sigma, table, (found,)) / table.sigma
    column = table.channels.index("q6")
    at_rail = grown[:, column] > 1.0
    assert 0 < at_rail.sum() < len(at_rail) // 2
    assert grown[at_rail, column] == pytest.approx(CENSORED)
    assert (grown[:, :column] == 1.0).all()
