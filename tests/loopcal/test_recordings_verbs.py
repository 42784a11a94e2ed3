"""info, doctor and recover as a user runs them: what they print, and their exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import Result

from recordings.events import Dwell, Fault, LedgerEntry, Mark, Reading
from recordings.reader import read_recording
from recordings.rig import rig_text
from recordings.session import Session
from recordings.storage import Storage
from recordings.writer import Writer

Run = Callable[..., Result]
SECOND = 1_000_000_000
START_NS = 1_750_000_000 * SECOND


def write(path: Path, storage: Storage | None = None) -> tuple[Path, ...]:
    """Ten seconds of the shoulder; the first three of its channels lost something each."""
    session = Session("monday", START_NS, "Ada", "second shift", "bench-pc")
    with Writer(path, rig_text("shoulder")[0], session, storage) as writer:
        for i in range(500):
            t = START_NS + i * SECOND // 50
            for k in (1, 2, 3, 4):
                writer.write(Reading(f"d{k}", t, (k * i) % 1013))
            if i % 100 == 99:
                writer.write(Dwell(t, t - SECOND, t, i // 100, 0))
            if i % 25 == 24:
                writer.flush()
        writer.write(Mark(t, "the operator bumped the table"))
        writer.write(Fault(t, "adc1", "silent", "No reply for 3 s."))
        writer.write(LedgerEntry("d1", t, 512, 500, 12, 0, 0, 0))
    return writer.paths


def damage(path: Path) -> None:
    """A wrong bit in the third chunk, and the end cut off inside the last."""
    data = bytearray(path.read_bytes())
    chunks = [at for at in range(len(data)) if data.startswith(b"\x04\0\0\0zstd", at)]
    data[chunks[2] + 40] ^= 1
    path.write_bytes(data[: chunks[-1] + 20])


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    write(tmp_path / "whole.mcap")
    return tmp_path / "whole.mcap"


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    write(tmp_path / "damaged.mcap")
    damage(tmp_path / "damaged.mcap")
    return tmp_path / "damaged.mcap"


@pytest.fixture
def hopeless(tmp_path: Path) -> Path:
    path = tmp_path / "hopeless.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(20_000))
    return path


def test_info_tells_what_a_recording_is(loopcal: Run, whole: Path) -> None:
    outcome = loopcal("info", whole)
    assert outcome.exit_code == 0
    text = " ".join(outcome.stdout.split())
    for words in (
        "whole.mcap: whole",
        "shoulder (platform, 4 channels)",
        "monday, by Ada, on bench-pc",
        "second shift",
        "2025-06-15 15:06:40 UTC",
        "10.0 s",
        "5 at 5 poses",
        "d1 leg1 500 50 Hz 12 0 0 0",
        "marks (1)",
        "the operator bumped the table",
        "adc1 silent: No reply for 3 s.",
    ):
        assert words in text, words
    assert max(len(line) for line in outcome.stdout.splitlines() if "/" not in line) <= 80


def test_info_tells_it_to_programs(loopcal: Run, whole: Path, damaged: Path) -> None:
    outcome = loopcal("info", whole, damaged, "--json")
    assert outcome.exit_code == 1
    told = json.loads(outcome.stdout)
    assert told["schema"] == 1
    first, second = told["recordings"]
    assert (first["state"], second["state"]) == ("whole", "damaged")
    assert first["rig"] == "shoulder"
    assert first["channels"][0] == {
        "name": "d1",
        "senses": "leg1",
        "readings": 500,
        "rate_hz": pytest.approx(50.0),
        "missing": 0,
        "ledger": {
            "expected": 512,
            "received": 500,
            "dropped_by_device": 12,
            "dropped_by_host": 0,
            "lost_in_gaps": 0,
            "gaps": 0,
            "unaccounted": 0,
        },
    }
    assert first["faults"][0]["kind"] == "silent"
    assert second["files"][0]["closed"] is False
    assert len(second["damage"]) == len(second["files"][0]["damage"]) > 1


def test_doctor_tells_what_to_do(loopcal: Run, whole: Path, damaged: Path) -> None:
    outcome = loopcal("doctor", whole)
    assert outcome.exit_code == 0
    assert "whole, with remarks" in outcome.stdout
    assert "caution: d1: 12 of 512 readings were lost by the device" in outcome.stdout
    outcome = loopcal("doctor", damaged)
    text = " ".join(outcome.stdout.split())
    assert outcome.exit_code == 1
    assert "damaged, but readable" in text
    assert "was never closed" in text
    assert "`loopcal recover " in text
    told = json.loads(loopcal("doctor", damaged, "--json").stdout)
    kinds = {finding["kind"]: finding["severity"] for finding in told["recordings"][0]["findings"]}
    assert kinds["never-closed"] == "bad"


def test_recover_makes_a_whole_recording(loopcal: Run, damaged: Path, tmp_path: Path) -> None:
    before = damaged.read_bytes()
    outcome = loopcal("recover", damaged, "-o", tmp_path / "new.mcap")
    assert outcome.exit_code == 1
    assert "lost: d1, d2, d3, d4: 25 readings each" in outcome.stdout
    assert damaged.read_bytes() == before
    assert loopcal("info", tmp_path / "new.mcap").exit_code == 0
    assert loopcal("doctor", tmp_path / "new.mcap").exit_code == 0
    left = read_recording(damaged, damaged_ok=True)
    new = read_recording(tmp_path / "new.mcap")
    assert new.readings["d1"].raw.tolist() == left.readings["d1"].raw.tolist()


def test_recover_of_a_whole_recording_says_so(loopcal: Run, whole: Path, tmp_path: Path) -> None:
    outcome = loopcal("recover", whole, "-o", tmp_path / "new.mcap")
    assert outcome.exit_code == 0
    assert "nothing was damaged" in outcome.stdout


@pytest.mark.parametrize("verb", ["info", "doctor", "recover"])
def test_exit_codes_tell_wrong_use_from_hopeless(
    loopcal: Run, verb: str, whole: Path, hopeless: Path, tmp_path: Path
) -> None:
    rest = ("-o", tmp_path / "new.mcap") if verb == "recover" else ()
    assert loopcal(verb, tmp_path / "none.mcap", *rest).exit_code == 2
    assert loopcal(verb, tmp_path, *rest).exit_code == 2
    assert loopcal(verb, hopeless, *rest).exit_code == 3
    empty = tmp_path / "empty.mcap"
    empty.touch()
    outcome = loopcal(verb, empty, *rest)
    assert outcome.exit_code == 3
    assert "is empty" in outcome.stderr
    assert not (tmp_path / "new.mcap").exists()


def test_the_worst_of_several_files_counts_and_all_are_shown(
    loopcal: Run, whole: Path, damaged: Path, hopeless: Path, tmp_path: Path
) -> None:
    outcome = loopcal("info", hopeless, tmp_path / "none.mcap", damaged, whole)
    assert outcome.exit_code == 3
    assert "whole.mcap: whole" in outcome.stdout
    assert "there is no file" in outcome.stderr


def test_recover_overwrites_nothing(loopcal: Run, damaged: Path, whole: Path) -> None:
    before = whole.read_bytes()
    outcome = loopcal("recover", damaged, "-o", whole)
    assert outcome.exit_code == 2
    assert "exists already" in outcome.stderr
    assert whole.read_bytes() == before


def test_a_lost_rig_can_be_given(loopcal: Run, whole: Path, tmp_path: Path) -> None:
    whole.write_bytes(whole.read_bytes().replace(b"platform", b"flatform"))
    assert loopcal("recover", whole, "-o", tmp_path / "new.mcap").exit_code == 3
    outcome = loopcal("recover", whole, "-o", tmp_path / "new.mcap", "--rig", "shoulder")
    assert outcome.exit_code == 1
    assert len(read_recording(tmp_path / "new.mcap").readings["d1"]) == 500
    wrong = loopcal("recover", whole, "-o", tmp_path / "newer.mcap", "--rig", "nonsense")
    assert wrong.exit_code == 2


def test_parts_are_shown_and_joined(loopcal: Run, tmp_path: Path) -> None:
    paths = write(tmp_path / "run.mcap", Storage(rotate_s=4))
    assert len(paths) == 3
    text = " ".join(loopcal("info", paths[0]).stdout.split())
    assert "1 to 3: run.mcap, run.002.mcap, run.003.mcap" in text
    assert "d2 leg2 500" in text
    assert "2: run.002.mcap" in " ".join(loopcal("info", paths[1]).stdout.split())
    paths[2].rename(tmp_path / "away.mcap")
    outcome = loopcal("doctor", paths[0])
    assert outcome.exit_code == 1
    assert "part 3 and what may follow it is missing" in " ".join(outcome.stdout.split())
    (tmp_path / "away.mcap").rename(paths[2])
    damage(paths[1])
    outcome = loopcal("recover", paths[0], "-o", tmp_path / "one.mcap")
    assert outcome.exit_code == 1
    whole = read_recording(tmp_path / "one.mcap")
    assert 350 < len(whole.readings["d2"]) < 500
    described: dict[str, Any] = json.loads(loopcal("info", tmp_path / "one.mcap", "--json").stdout)
    missing = described["recordings"][0]["channels"][1]["missing"]
    assert missing == 500 - len(whole.readings["d2"])


@pytest.mark.parametrize("verb", ["info", "doctor", "recover"])
def test_help_names_the_exit_codes(loopcal: Run, verb: str) -> None:
    text = " ".join(loopcal(verb, "--help").stdout.split())
    assert "hopeless" in text
    assert "3:" in text or "3 :" in text
