"""`loopcal bench-calibrate` from table to rig file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from loopcal.cli import app
from recordings.rig import load_rig, rig_text

RUNNER = CliRunner()


@pytest.fixture
def table(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    x = np.repeat(np.linspace(-40.0, 40.0, 9), 5)
    counts = np.rint(2051.3 + x / 0.03 + 2.0 * rng.standard_normal(len(x)))
    path = tmp_path / "table.csv"
    rows = [f"{a},{int(b)}" for a, b in zip(x, counts, strict=True)]
    path.write_text("displacement_mm,counts\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_the_result_goes_into_a_copy_of_the_rig(table: Path, tmp_path: Path) -> None:
    output = tmp_path / "calibrated.toml"
    answer = RUNNER.invoke(
        app, ["bench-calibrate", "shoulder", "d2", str(table), "-o", str(output)]
    )
    assert answer.exit_code == 0, answer.output
    before, after = load_rig("shoulder").channel("d2"), load_rig(str(output)).channel("d2")
    assert after.gain.uncertainty is not None
    assert abs(after.gain.nominal - 3e-5) < 4 * after.gain.uncertainty
    assert after.zero_count == 2051
    assert after.noise == pytest.approx(2.0, rel=0.5)
    # The same counts mean the same length as before, but for the new gain.
    same = after.gain.nominal * (2048 - after.zero_count) + after.offset.nominal
    assert same == pytest.approx(before.offset.nominal, abs=1e-9)
    assert after.offset.identify
    text, original = output.read_text("utf-8"), rig_text("shoulder")[0]
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        line for line in original.splitlines() if line.startswith("#")
    ]
    assert load_rig(str(output)).channel("d1") == load_rig("shoulder").channel("d1")


def test_a_channel_without_offset_gets_the_fraction_of_a_count(table: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    text = rig_text("shoulder")[0]
    offset = "offset_mm = { nominal = 100.3, uncertainty = 2.0, identify = true }\n"
    assert offset in text
    rig.write_text(text.replace(offset, ""), encoding="utf-8")
    output = tmp_path / "calibrated.toml"
    answer = RUNNER.invoke(app, ["bench-calibrate", str(rig), "d2", str(table), "-o", str(output)])
    assert answer.exit_code == 0, answer.output
    after = load_rig(str(output)).channel("d2")
    assert after.offset.uncertainty is not None
    zero = after.zero_count - after.offset.nominal / after.gain.nominal
    assert abs(zero - 2051.3) < 4 * after.offset.uncertainty / after.gain.nominal


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("angle_deg,counts\n1,2\n2,3\n3,4\n", "senses length"),
        ("x,counts\n1,2\n", "expected 'counts' and one of"),
        ("displacement_mm,counts\n1,two\n", "line 2"),
        ("displacement_mm,counts\n1\n", "line 2"),
        ("displacement_mm,counts\n", "at least 3"),
    ],
)
def test_wrong_tables_are_told(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(content, encoding="utf-8")
    answer = RUNNER.invoke(app, ["bench-calibrate", "shoulder", "d2", str(path)])
    assert answer.exit_code == 2
    assert words in answer.output


def test_nothing_is_overwritten(table: Path, tmp_path: Path) -> None:
    output = tmp_path / "rig.toml"
    output.write_text("mine", encoding="utf-8")
    answer = RUNNER.invoke(
        app, ["bench-calibrate", "shoulder", "d2", str(table), "-o", str(output)]
    )
    assert answer.exit_code == 2
    assert output.read_text("utf-8") == "mine"
