"""Bad input: one clear error, exit code 2, no traceback, and existing files untouched."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from recordings.rig import rig_text

Run = Callable[..., Result]


def refused(outcome: Result, *words: str) -> None:
    """The command ended with exit code 2 and one message that holds these words."""
    text = " ".join(outcome.stderr.split())
    assert outcome.exit_code == 2, text
    assert outcome.stderr.count("loopcal: ") == 1
    for word in words:
        assert word in text


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from typer.testing import CliRunner

    from loopcal.cli import app

    path = tmp_path_factory.mktemp("good") / "shoulder.mcap"
    outcome = CliRunner().invoke(app, ["simulate", "shoulder", "-o", str(path), "--poses", "15"])
    assert outcome.exit_code == 0
    return path


def rig_with(tmp_path: Path, rig: str, old: str, new: str) -> Path:
    text = rig_text(rig)[0]
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('senses = "joint3"\n', "", ("channel 'q3'", "senses")),
        ("a_m = {", "aa_m = {", ("joint 'hinge'", "aa_m", "did you mean 'a_m'")),
        ("s_m = 0.355", "s = 0.355", ("'s' needs its unit", "s_m or s_mm")),
        ('device = "encoder1"', 'device = "encoder9"', ("encoder9", "encoder1")),
        ("schema = 1", "schema = 7", ("schema", "7")),
        ("schema = 1", "schema = = 1", ("not a TOML file",)),
    ],
)
def test_a_wrong_rig(
    loopcal: Run, tmp_path: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    rig = rig_with(tmp_path, "arm", old, new)
    for command in (
        ("rig", "check", rig),
        ("simulate", rig, "-o", tmp_path / "x.mcap"),
        ("capture", rig, "-o", tmp_path / "x.mcap"),
    ):
        refused(loopcal(*command), *words)
    assert not (tmp_path / "x.mcap").exists()


def test_a_rig_that_does_not_exist(loopcal: Run, tmp_path: Path) -> None:
    refused(loopcal("rig", "check", tmp_path / "none.toml"), "none.toml", "bundled rigs: arm, ")


def test_a_mechanism_that_does_not_close(loopcal: Run, tmp_path: Path) -> None:
    far = rig_with(tmp_path, "arm", "a_m = { nominal = 0.202", "a_m = { nominal = 5.0")
    refused(loopcal("simulate", far, "-o", tmp_path / "x.mcap"), "close")
    outcome = loopcal("rig", "check", far)
    assert outcome.exit_code == 1
    assert "does not close" in " ".join(outcome.stderr.split())


def test_readings_that_do_not_close_the_loop(loopcal: Run, tmp_path: Path) -> None:
    from recordings.reader import read_recording
    from recordings.writer import Session, Writer

    path = tmp_path / "arm.mcap"
    assert loopcal("simulate", "arm", "-o", path, "--poses", "12").exit_code == 0
    good = read_recording(path)
    bad_toml = good.rig_toml.replace("a_m = { nominal = 0.202", "a_m = { nominal = 5.0", 1)
    with Writer(tmp_path / "bad.mcap", bad_toml, Session()) as writer:
        for name, readings in good.readings.items():
            writer.write_readings(name, readings.time_ns, readings.raw)
        for dwell in good.dwells:
            writer.write(dwell)
    refused(loopcal("solve", tmp_path / "bad.mcap"), "does not close", "rig check")


def test_a_port_that_does_not_exist(loopcal: Run, tmp_path: Path) -> None:
    output = tmp_path / "x.mcap"
    outcome = loopcal(
        "capture",
        "arm",
        "-o",
        output,
        "--port",
        f"arm-can={tmp_path / 'can'}",
        "--port",
        f"arm-wrist={tmp_path / 'wrist'}",
    )
    refused(outcome, "arm-can", "arm-wrist", "nothing was recorded")
    assert not output.exists()


def test_a_port_that_the_rig_does_not_have(loopcal: Run, tmp_path: Path) -> None:
    refused(
        loopcal("capture", "arm", "-o", tmp_path / "x.mcap", "--port", "usb=/dev/null"),
        "usb",
        "arm-can",
    )


def test_a_port_option_without_a_path(loopcal: Run, tmp_path: Path) -> None:
    assert loopcal("capture", "arm", "-o", tmp_path / "x.mcap", "--port", "arm-can").exit_code == 2


def test_a_truncated_recording(loopcal: Run, recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    refused(
        loopcal("solve", cut, "--json", tmp_path / "r.json"),
        "cut.mcap",
        "damaged",
        "can still be read",
    )
    assert not (tmp_path / "r.json").exists()


def test_a_foreign_file(loopcal: Run, tmp_path: Path) -> None:
    foreign = tmp_path / "notes.mcap"
    foreign.write_text("not a recording")
    refused(loopcal("solve", foreign), "notes.mcap", "not an MCAP file")
    refused(loopcal("solve", tmp_path / "none.mcap"), "no file")
    refused(loopcal("solve", tmp_path), "not a file")


def test_a_recording_without_dwells(loopcal: Run, recording: Path, tmp_path: Path) -> None:
    import numpy as np

    from recordings.reader import read_recording
    from recordings.writer import Session, Writer

    good = read_recording(recording)
    rng = np.random.default_rng(0)
    moving = tmp_path / "moving.mcap"
    with Writer(moving, good.rig_toml, Session()) as writer:
        time_ns = np.arange(3000) * 20_000_000
        for k, name in enumerate(good.readings):
            raw = 2000 + 1500 * np.sin(time_ns * 1e-9 * (1.0 + 0.3 * k)) + rng.normal(0, 5, 3000)
            writer.write_readings(name, time_ns, raw.astype(np.int64))
    refused(loopcal("solve", moving), "no dwells", "still")


def test_too_few_poses(loopcal: Run, recording: Path) -> None:
    refused(loopcal("solve", recording, "-n", "3"), "3 usable poses", "7 unknowns", "at least 8")


def test_a_method_that_is_not_there_or_does_not_fit(loopcal: Run, recording: Path) -> None:
    refused(loopcal("solve", recording, "--method", "magic"), "magic", "ml, hinge, multi-loop")
    refused(loopcal("solve", recording, "--method", "hinge"), "does not fit", "ml, multi-loop")


def test_nothing_is_overwritten(loopcal: Run, recording: Path) -> None:
    before = recording.read_bytes()
    for command in ("simulate", "capture"):
        refused(loopcal(command, "shoulder", "-o", recording), "exists already")
    assert recording.read_bytes() == before


@pytest.mark.parametrize(
    "words",
    [("solve", "--report"), ("solve", "--json"), ("gap", "--json"), ("gap", "--next")],
)
def test_a_folder_that_is_not_there_is_told_before_the_work_is_done(
    loopcal: Run,
    recording: Path,
    tmp_path: Path,
    words: tuple[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    verb, option = words

    def work(*_: object, **__: object) -> None:
        raise AssertionError("it has begun to work")

    monkeypatch.setattr("loopcal.solving.run_solve", work)
    monkeypatch.setattr("loopcal.gap.run_gap", work)
    nowhere = tmp_path / "nowhere"
    refused(loopcal(verb, recording, option, nowhere / "file"), "there is no folder", str(nowhere))


def test_a_truth_file_that_is_none(loopcal: Run, recording: Path, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("[]")
    refused(loopcal("solve", recording, "--truth", wrong), "not a truth file")


def test_an_unknown_effect(loopcal: Run, tmp_path: Path) -> None:
    refused(
        loopcal("simulate", "arm", "-o", tmp_path / "x.mcap", "--hide", "magic@q1=1"),
        "magic",
        "nonlinearity",
    )


def test_a_bench_that_cannot_run_leaves_no_truth_behind(loopcal: Run, tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    port = f"--port=nowhere={tmp_path / 'line'}"
    refused(loopcal("sim", "shoulder", port, f"--truth={truth}"), "nowhere", "shoulder-adc")
    assert not truth.exists()
