"""`loopcal gap`: the answer in words and as JSON, the grown rig, and input that it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from loopcal.cli import app
from recordings.rig import parse_rig, rig_text

Run = Callable[..., Result]

BENT = "nonlinearity@d1=2%"
ONCE = "revisit = { poses = 0, visits = 1 }"


def simulated(path: Path, *words: str, rig: str = "shoulder") -> Path:
    outcome = CliRunner().invoke(app, ["simulate", rig, "-o", str(path), *words])
    assert outcome.exit_code == 0, outcome.stderr
    return path


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A shoulder one of whose transducers is not straight."""
    folder = tmp_path_factory.mktemp("bent")
    return simulated(folder / "bent.mcap", "--poses", "50", "--seed", "5", "--hide", BENT)


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
    assert said.startswith("Missing: nonlinearity of d1, 0.")
    assert "cannot be told from: " in said
    assert "held-out poses" in said
    assert "% of the gap is closed" in said
    assert "standstill only" not in said  # motion was recorded, and shows no lag
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


def test_a_drift_that_slows_down_is_told_with_its_time_constant_and_recorded_again(
    loopcal: Run, tmp_path: Path
) -> None:
    # Nature lets this zero warm up with 95 s, of which a straight line is no part.
    rig, hidden = tmp_path / "grown.toml", ["--seed", "5", "--hide", "offset-drift@d2=-8e-6"]
    file = simulated(tmp_path / "warming.mcap", "--poses", "60", *hidden)
    outcome = loopcal("gap", file, "--rig-out", rig)
    said = " ".join(outcome.stdout.split())
    assert said.startswith("Missing: drift of the zero of d2, -0.00"), said
    assert "mm/s, the mean speed; it slows down with a time constant of " in said
    (effect,) = parse_rig(rig.read_text(), "grown").effects
    decay = effect.values["decay"]
    assert decay.nominal > 4 * decay.uncertainty
    again, result = tmp_path / "again.mcap", tmp_path / "again.json"
    assert loopcal("simulate", rig, "-o", again, "--seed", "5").exit_code == 0
    assert loopcal("solve", again, "--json", result).exit_code == 0
    told = {p["name"]: p for p in json.loads(result.read_text())["parameters"]}
    for name, quantity in effect.values.items():
        found = told[f"offset-drift@d2.{name}"]
        spread = np.hypot(quantity.uncertainty, found["standard_error"])
        assert abs(found["value"] - quantity.nominal) < 4 * spread
    outcome = loopcal("apply", result, again, "--corrections", tmp_path / "c.json")
    refused(outcome, "offset-drift@d2", "time since the session began", "one moment only")
    assert not (tmp_path / "c.json").exists()


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


def rewritten(recording: Path, path: Path, rig_toml: str) -> Path:
    """The same readings, recorded under another description."""
    from recordings.reader import read_recording
    from recordings.writer import Writer

    good = read_recording(recording)
    with Writer(path, rig_toml, good.session) as writer:
        for name, readings in good.readings.items():
            writer.write_readings(name, readings.time_ns, readings.raw)
        for dwell in good.dwells:
            writer.write(dwell)
    return path


@pytest.fixture(scope="module")
def poor(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """The answer, as JSON and as said, to six poses, none visited again, of a rig without masses."""
    folder = tmp_path_factory.mktemp("poor")
    text = "\n".join(
        line
        for line in rig_text("arm")[0].splitlines()
        if not line.startswith(("mass_kg", "com_m"))
    )
    (folder / "rig.toml").write_text(text.replace("revisit = { poses = 10, visits = 3 }", ONCE))
    recording = simulated(
        folder / "poor.mcap", "--poses", "6", "--seed", "2", rig=str(folder / "rig.toml")
    )
    outcome = CliRunner().invoke(app, ["gap", str(recording), "--json", "-"])
    assert outcome.exit_code in (0, 1), outcome.stderr
    return json.loads(outcome.stdout), " ".join(outcome.stderr.split())


def test_without_revisits_the_verdict_is_provisional(poor: tuple[dict[str, Any], str]) -> None:
    answer, said = poor
    assert answer["provisional"] is True
    assert answer["noise_floor"]["revisited_poses"] == 0
    assert "Provisional" in said
    assert "visited three times or more" in said


def test_of_few_poses_none_is_held_out(poor: tuple[dict[str, Any], str]) -> None:
    answer, said = poor
    assert answer["gap"] is None
    assert "6 poses are too few to hold any out" in said


def test_without_masses_compliance_cannot_be_tested(poor: tuple[dict[str, Any], str]) -> None:
    answer, said = poor
    untestable = [u for u in answer["untestable"] if u["name"] == "joint-compliance"]
    assert {u["where"] for u in untestable} == {f"joint{n}" for n in range(1, 8)}
    assert all("mass" in u["reason"] for u in untestable)
    assert (
        "joint-compliance (joint1, joint2, joint3, joint4, joint5, joint6, joint7): the rig" in said
    )


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ('name = "nonsense"\nwhere = "d1"\nsize_m = 0.001', ("nonsense", "known", "backlash")),
        ('name = "backlash"\nwhere = "d9"\ngap_m = 0.001', ("backlash", "d9", "d1, d2, d3, d4")),
        ('name = "backlash"\nwhere = "d1"\nstep_m = 0.001', ("backlash@d1", "step", "gap")),
        (
            'name = "lag"\nwhere = "d1"\ndelay_s = { nominal = 0.01, identify = true }',
            ("lag@d1", "standstill"),
        ),
    ],
)
def test_a_grown_rig_that_does_not_fit_its_recording(
    loopcal: Run, bent: Path, tmp_path: Path, entry: str, words: tuple[str, ...]
) -> None:
    text = f"{rig_text('shoulder')[0]}\n[[effect]]\n{entry}\n"
    refused(loopcal("gap", rewritten(bent, tmp_path / "odd.mcap", text)), *words)


def test_a_description_that_is_far_off_is_said(loopcal: Run, tmp_path: Path) -> None:
    arm = simulated(tmp_path / "arm.mcap", "--poses", "12", rig="arm")
    text = rig_text("arm")[0].replace("a_m = { nominal = 0.202", "a_m = { nominal = 5.0", 1)
    outcome = loopcal("gap", rewritten(arm, tmp_path / "odd.mcap", text), "--json", "-")
    (caution,) = json.loads(outcome.stdout)["cautions"]
    assert "hinge.a ends -4.8 m from its nominal value" in caution
    assert "Mend the rig" in " ".join(outcome.stderr.split())


def test_fewer_poses_than_parameters(loopcal: Run, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(rig_text("shoulder")[0].replace("revisit = { poses = 10, visits = 3 }", ONCE))
    few = simulated(tmp_path / "few.mcap", "--poses", "4", rig=str(rig))
    refused(loopcal("gap", few), "poses", "unknowns", "Record more")


def test_a_damaged_or_foreign_recording(loopcal: Run, bent: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(bent.read_bytes()[: bent.stat().st_size // 2])
    refused(loopcal("gap", cut, "--json", tmp_path / "gap.json"), "cut.mcap", "damaged")
    assert not (tmp_path / "gap.json").exists()
    refused(loopcal("gap", tmp_path / "none.mcap"), "no file")
