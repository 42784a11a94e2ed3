"""A reader of tomorrow opens today's files: golden recordings of each version of the format."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from recordings.errors import DamagedRecording
from recordings.reader import read_recording
from recordings.survey import survey

GOLDEN = Path(__file__).parent / "golden"
EXPECTED = sorted(GOLDEN.glob("*/*.json"))


@pytest.fixture(scope="module")
def make() -> ModuleType:
    spec = importlib.util.spec_from_file_location("golden_make", GOLDEN / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def check(expectation: Path) -> None:
    """The recording beside ``expectation`` says what that expects."""
    told = json.loads(expectation.read_text("utf-8"))
    path = expectation.with_suffix(".mcap")
    if not told["whole"]:
        with pytest.raises(DamagedRecording):
            read_recording(path)
    found = read_recording(path, damaged_ok=True)
    assert bool(found.damage) is not told["whole"]
    assert found.rig_toml == told["rig_toml"]
    assert dataclasses.asdict(found.session) == told["session"]
    for channel, columns in told["readings"].items():
        for name, expected in columns.items():
            column = getattr(found.readings[channel], name)
            assert (None if column is None else column.tolist()) == expected, (channel, name)
    for kind, events in (
        ("Dwell", found.dwells),
        ("Mark", found.marks),
        ("Fault", found.faults),
        ("ModeCommand", found.mode_commands),
        ("ModeReport", found.mode_reports),
        ("ClockSample", found.clock),
    ):
        # A version that knows more fields finds them absent.
        expected = told[kind]
        known = (
            [{key: getattr(e, key) for key in told[kind][0]} for e in events] if expected else []
        )
        assert known == expected, kind
        assert len(events) == len(expected)
    for entry in told["LedgerEntry"]:
        assert dataclasses.asdict(found.ledger[entry["source"]]) == entry
    seen = survey(path)
    for channel in told["readings"]:
        assert (seen.channel(channel).missing or 0) == told["missing"]


@pytest.mark.parametrize(
    "expectation", EXPECTED, ids=lambda path: f"{path.parent.name}-{path.stem}"
)
def test_a_golden_recording_says_what_it_said_when_it_was_written(expectation: Path) -> None:
    check(expectation)


def test_every_version_is_here() -> None:
    names = {(path.parent.name, path.stem) for path in EXPECTED}
    assert names >= {
        ("0", "whole"),
        *((version, name) for version in "1" for name in ("whole", "damaged", "foreign", "parts")),
    }


def test_they_are_small() -> None:
    assert sum(path.stat().st_size for path in GOLDEN.rglob("*.mcap")) < 100_000


def test_what_is_written_today_is_what_the_goldens_are(make: ModuleType, tmp_path: Path) -> None:
    make.main(tmp_path / "new")
    for expectation in sorted((tmp_path / "new").glob("*.json")):
        check(expectation)
        golden = json.loads((GOLDEN / "1" / expectation.name).read_text("utf-8"))
        assert json.loads(expectation.read_text("utf-8")) == golden


def test_a_version_is_never_written_again() -> None:
    before = {path: path.read_bytes() for path in GOLDEN.rglob("*.mcap")}
    ran = subprocess.run(
        [sys.executable, GOLDEN / "make.py", "1"], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 1
    assert "never written again" in ran.stderr
    assert {path: path.read_bytes() for path in GOLDEN.rglob("*.mcap")} == before
