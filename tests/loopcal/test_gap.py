"""`loopcal gap`: the answer in words and as JSON, the grown rig, and input that it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from loopcal.cli import app
from recordings.rig import parse_rig, rig_text

Run = Callable[..., Result]


def simulated(path: Path, *words: str, rig: str = "shoulder") -> Path:
    outcome = CliRunner().invoke(app, ["simulate", rig, "-o", str(path), *words])
    assert outcome.exit_code == 0, outcome.stderr
    return path


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A shoulder one of whose transducers is not straight."""
    folder = tmp_path_factory.mktemp("bent")
    return simulated(folder / "bent.mcap", "--seed", "5", "--hide", "nonlinearity@d1=2%")


@pytest.fixture(scope="module")
def analysed(bent: Path) -> Path:
    """The folder of `bent` with everything that an analysis of it can write."""
    folder = bent.parent
    outcome = CliRunner().invoke(
        app,
        [
            "gap",
            str(bent),
            "--json",
            str(folder / "gap.json"),
            "--rig-out",
            str(folder / "grown.toml"),
            "--report",
            str(folder / "gap.html"),
        ],
    )
    assert outcome.exit_code == 0, outcome.stderr
    (folder / "said.txt").write_text(outcome.stdout)
    return folder


def refused(outcome: Result, *words: str) -> None:
    text = " ".join(outcome.stderr.split())
    assert outcome.exit_code == 2, text
    assert outcome.stderr.count("loopcal: ") == 1
    for word in words:
        assert word in text


def test_says_what_is_missing_and_what_it_leaves_open(analysed: Path) -> None:
    said = " ".join((analysed / "said.txt").read_text().split())
    assert said.startswith("Missing: nonlinearity of d1, 0.5")
    assert "cannot be told from: " in said
    assert "held-out poses" in said
    assert "% of the gap is closed" in said
    assert "lag (d1, d2, d3, d4): recorded at standstill only" in said
    assert "What to do next" in said


def test_the_json_says_the_same(analysed: Path) -> None:
    answer = json.loads((analysed / "gap.json").read_text())
    assert answer["verdict"] == "named"
    (effect,) = answer["effects"]
    assert (effect["name"], effect["where"], effect["unit"]) == ("nonlinearity", "d1", "m")
    assert 0 < effect["standard_error"] < 0.1 * effect["size"]
    assert answer["gap"]["before"] > 5.0 > answer["gap"]["after"]


def test_the_grown_rig_differs_from_its_parent_by_what_was_found(analysed: Path) -> None:
    grown, parent = (analysed / "grown.toml").read_text(), rig_text("shoulder")[0]
    assert {line for line in parent.splitlines() if line.startswith("#")} <= set(grown.splitlines())
    (effect,) = parse_rig(grown, "grown").effects
    assert (effect.name, effect.where) == ("nonlinearity", "d1")
    assert all(effect.values[p].identify for p in effect.values if p not in ("low", "high"))
    assert "# found missing by loopcal gap: nonlinearity of d1" in grown
    new = set(grown.splitlines()) - set(parent.splitlines())
    assert not any("uncertainty" not in line for line in new if "identify" in line)


def test_the_grown_rig_can_be_recorded_and_solved(loopcal: Run, analysed: Path) -> None:
    again = analysed / "again.mcap"
    assert loopcal("simulate", analysed / "grown.toml", "-o", again).exit_code == 0
    outcome = loopcal("solve", again, "--json", analysed / "again.json")
    assert outcome.exit_code == 0, outcome.stderr
    found = json.loads((analysed / "again.json").read_text())
    p2 = next(p for p in found["parameters"] if p["name"] == "nonlinearity@d1.p2")
    (effect,) = parse_rig((analysed / "grown.toml").read_text(), "grown").effects
    told = effect.values["p2"]
    assert abs(p2["value"] - told.nominal) < 5 * np.hypot(told.uncertainty, p2["standard_error"])
    assert abs(told.nominal) > 5 * p2["standard_error"]


def test_a_grown_rig_is_never_written_over_a_file(loopcal: Run, analysed: Path) -> None:
    before = (analysed / "grown.toml").read_bytes()
    outcome = loopcal("gap", analysed / "bent.mcap", "--rig-out", analysed / "grown.toml")
    refused(outcome, "grown.toml", "exists already")
    assert (analysed / "grown.toml").read_bytes() == before


def test_where_nothing_is_missing_no_rig_is_written(loopcal: Run, tmp_path: Path) -> None:
    clean = simulated(tmp_path / "clean.mcap", "--seed", "4")
    outcome = loopcal("gap", clean, "--json", "-", "--rig-out", tmp_path / "grown.toml")
    answer = json.loads(outcome.stdout)
    assert answer["verdict"] == "nothing-detectable"
    assert answer["detection_limits"]
    assert outcome.exit_code == 2
    said = " ".join(outcome.stderr.split())
    assert "Nothing detectable is missing" in said
    assert "no rig was written" in said
    assert not (tmp_path / "grown.toml").exists()
