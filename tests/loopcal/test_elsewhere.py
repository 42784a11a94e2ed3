"""Tables of a real arm: rig from its URDF, recording from its tables, solved, and back into the URDF."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import recordings
from loopcal.cli import app
from recordings.reader import read_recording
from recordings.rig import parse_rig
from recordings.tables import Table, import_tables
from solver.errors import NotEnoughData
from solver.samples import average

DATA = Path(recordings.__file__).parent.parent / "benchmarks/data/panda_ball_joint"
COLUMNS = ",".join(f"q{k}_rad" for k in range(1, 8))


def run(*arguments: str | Path) -> str:
    found = CliRunner().invoke(app, [str(a) for a in arguments])
    assert found.exit_code == 0, found.output
    return found.output


def test_a_real_arm_from_urdf_and_tables_to_a_calibrated_urdf(tmp_path: Path) -> None:
    rig, recording, result = tmp_path / "a.toml", tmp_path / "a.mcap", tmp_path / "a.json"
    urdf, tip = DATA / "panda.urdf", ("--tip", "ball_link")
    sockets = ("--fixture", "hole_0", "--fixture", "hole_1")
    run("rig", "from-urdf", urdf, *tip, *sockets, "--gravity-compensated", "-o", rig)
    assert 'standing = "gravity-compensated"' in rig.read_text("utf-8")
    with rig.open("a") as file:
        file.write('\n[[mechanism.distance]]\nbetween = ["hole_0", "hole_1"]\n')
        file.write("distance_mm = { nominal = 50, uncertainty = 0.05 }\n")
    place = DATA / "panda_2_clean/front_center"
    tables = (place / "hole_0.csv", f"hole_1={place / 'hole_1.csv'}")
    run("import", rig, *tables, "--columns", COLUMNS, "-o", recording)
    run("solve", recording, "-n", "60", "--json", result)
    document = json.loads(result.read_text("utf-8"))
    assert document["poses"]["used"] == 60
    assert {null["held_by"] for null in document["unidentifiable"]} == {"stated uncertainties"}
    assert 0.5 < document["residual"]["chi2_per_dof"] < 2.0
    run("export-urdf", result, urdf, *tip, "-o", tmp_path / "a.urdf")
    assert (tmp_path / "a.urdf").read_text("utf-8") != urdf.read_text("utf-8")


def test_single_readings_need_a_stated_noise(tmp_path: Path) -> None:
    text = """
schema = 1
name = "one"
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "turn"
[[channel]]
name = "q1"
senses = "turn"
gain_rad_per_count = 1e-9
"""
    table = tmp_path / "t.csv"
    table.write_text("q1_rad\n0.5\n0.6\n", "utf-8")
    stated = text + "noise_counts = 40\n"
    for name, toml in (("without", text), ("with", stated)):
        import_tables(parse_rig(toml), toml, [Table(table)], tmp_path / name)
    with pytest.raises(NotEnoughData, match="states none for q1: give noise_counts"):
        average(read_recording(tmp_path / "without"))
    found = average(read_recording(tmp_path / "with"))
    assert found.counts.tolist() == [[5e8], [6e8]]
    assert found.sigma.tolist() == [[40.0], [40.0]]
