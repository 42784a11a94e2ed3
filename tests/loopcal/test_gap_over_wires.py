"""An effect that virtual devices hide, captured over CAN and Modbus, and named from the recording."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from recordings.rig import rig_text
from tests.child_process import child_process

SHORTER = (
    ("poses = 60", "poses = 14"),
    ("dwell_s = 0.3", "dwell_s = 0.2"),
    ("settle_s = 0.15", "settle_s = 0.1"),
    ("move_deg_per_s = 90", "move_deg_per_s = 240"),
    ("revisit = { poses = 10, visits = 3 }", "revisit = { poses = 4, visits = 2 }"),
)


@pytest.mark.wires
def test_what_virtual_devices_hide_is_named(
    loopcal: Callable[..., Result], tmp_path: Path, patient: Callable[[str], str]
) -> None:
    text = patient(rig_text("arm")[0])
    for old, new in SHORTER:
        assert old in text
        text = text.replace(old, new)
    rig, truth = tmp_path / "arm.toml", tmp_path / "truth.json"
    rig.write_text(text)
    ports = [f"--port={name}={tmp_path / name}" for name in ("arm-can", "arm-wrist")]
    hidden = ["--hide=nonlinearity@q6=2%", f"--truth={truth}", "--seed=3"]
    command = [sys.executable, "-m", "loopcal", "sim", str(rig), *ports, *hidden]
    for attempt in range(8):  # a computer that stands still may end the session
        recording = tmp_path / f"run-{attempt}.mcap"
        truth.unlink(missing_ok=True)
        with child_process(command) as bench:
            assert bench.stdout is not None
            assert any(line.startswith("ready") for line in bench.stdout)
            outcome = loopcal("capture", rig, "-o", recording, *ports)
        if outcome.exit_code == 0:
            break
    assert outcome.exit_code == 0, outcome.stderr
    outcome = loopcal("gap", recording, "--json", tmp_path / "gap.json")
    assert outcome.exit_code == 0, outcome.stderr
    answer = json.loads((tmp_path / "gap.json").read_text())
    (effect,) = answer["effects"]
    assert (effect["name"], effect["where"]) == ("nonlinearity", "q6")
    (known,) = json.loads(truth.read_text())["effects"]
    # Over other stops than the plan's the RMS of one shape is a little different.
    assert abs(effect["size"] - known["size"]) < 0.25 * known["size"]
    assert answer["gap"]["closed"] > 0.9
