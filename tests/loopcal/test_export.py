"""What is exported is what is in the file, by the mcap library's own reading of it."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import Result

from loopcal import export_rows
from recordings.events import Dwell
from recordings.session import Session
from recordings.writer import Writer

Run = Callable[..., Result]

START_NS = 1_700_000_000_000_000_000
RIG = """\
schema = 1
name = "bench"

[mechanism]
family = "serial"

[[mechanism.joint]]
name = "base"
a_m = 0.3

[[mechanism.joint]]
name = "slide"
type = "prismatic"

[[channel]]
name = "turn"
senses = "base"
gain_deg_per_count = 0.09
offset_deg = 1.5
zero_count = 100
modulus_counts = 4000

[[channel]]
name = "way"
senses = "slide"
gain_mm_per_count = -0.01
"""


@dataclass(frozen=True)
class Expected:
    """One reading as the table must give it."""

    channel: str
    time_ns: int
    device_time_ns: int | None
    sequence: int | None
    flags: int
    raw_counts: int
    value_rad: float | None
    value_m: float | None
    pose: int | None
    visit: int | None
    fixture: str | None


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    rng = np.random.default_rng(8)
    path = tmp_path / "a.mcap"
    with Writer(path, RIG, Session(session_id="s1", start_ns=START_NS)) as writer:
        for second in range(4):
            time_ns = START_NS + second * 10**9 + np.arange(700) * 1_000_000
            numbers = second * 700 + np.arange(700)
            writer.write_readings(
                "turn", time_ns, rng.integers(-9000, 9000, 700), time_ns - 5, numbers, numbers % 5
            )
            writer.write_readings(
                "way", time_ns[::3] + second % 2, rng.integers(-(2**40), 2**40, 234)
            )
            start = START_NS + second * 10**9 + 100_000_000
            held = "near" if second % 2 else None
            writer.write(
                Dwell(start + 9, start, start + 300_000_000, second // 2, second % 2, held)
            )
    return path


def by_the_mcap_library(path: Path) -> list[Expected]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages())
    dwells = [m.decoded_message for m in found if m.channel.topic == "/session/dwell"]
    rows = []
    for _, channel, message, reading in found:
        kind, _, name = channel.topic.rpartition("/")
        if kind != "/channel":
            continue
        t = message.log_time
        dwell = next((d for d in dwells if d.start_ns <= t <= d.end_ns), None)
        turn = name == "turn"
        counts = (reading.raw - 100 + 2000) % 4000 - 2000
        rows.append(
            Expected(
                name,
                t,
                reading.device_time_ns if reading.HasField("device_time_ns") else None,
                reading.sequence if reading.HasField("sequence") else None,
                reading.flags,
                reading.raw,
                np.deg2rad(0.09 * counts + 1.5) if turn else None,
                None if turn else -0.01e-3 * reading.raw,
                None if dwell is None else dwell.pose,
                None if dwell is None else dwell.visit,
                None if dwell is None or not dwell.HasField("fixture") else dwell.fixture,
            )
        )
    return sorted(rows, key=lambda row: (row.time_ns, row.channel))


def assert_rows(found: list[dict[str, Any]], expected: list[Expected]) -> None:
    assert len(found) == len(expected)
    for row, wanted in zip(found, expected, strict=True):
        for name in Expected.__dataclass_fields__:
            want = getattr(wanted, name)
            if name.startswith("value") and want is not None:
                assert row[name] == pytest.approx(want, rel=1e-12, abs=1e-15)
            else:
                assert row[name] == want, name


def test_csv_holds_every_reading(
    loopcal: Run, tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export_rows, "ROWS", 300)  # many stretches
    outcome = loopcal("export", recording, "-o", tmp_path / "a.csv")
    assert outcome.exit_code == 0, outcome.output
    assert "3,736 readings" in outcome.output
    with (tmp_path / "a.csv").open(newline="") as file:
        table = list(csv.DictReader(file))

    def typed(name: str, text: str) -> object:
        if text == "":
            return None
        if name in ("channel", "fixture"):
            return text
        return float(text) if name.startswith("value") else int(text)

    rows = [{name: typed(name, text) for name, text in row.items()} for row in table]
    assert_rows(rows, by_the_mcap_library(recording))


def test_parquet_holds_every_reading(loopcal: Run, tmp_path: Path, recording: Path) -> None:
    outcome = loopcal("export", recording, "-o", tmp_path / "a.parquet")
    assert outcome.exit_code == 0, outcome.output
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    assert_rows(table.to_pylist(), by_the_mcap_library(recording))
    assert table.schema.metadata[b"loopcal.session_id"] == b"s1"
    assert b'name = "bench"' in table.schema.metadata[b"loopcal.rig.toml"]


def test_without_pyarrow_the_message_says_what_to_install(
    loopcal: Run, tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    outcome = loopcal("export", recording, "-o", tmp_path / "a.parquet")
    assert outcome.exit_code == 2
    assert "pip install 'loopcal[parquet]'" in outcome.stderr
    assert not (tmp_path / "a.parquet").exists()


def test_what_cannot_be_exported_is_said_and_touches_nothing(
    loopcal: Run, tmp_path: Path, recording: Path
) -> None:
    outcome = loopcal("export", recording, "-o", tmp_path / "a.xlsx")
    assert outcome.exit_code == 2
    assert "expected one of: .csv, .parquet" in outcome.stderr
    there = tmp_path / "there.csv"
    there.write_text("mine")
    outcome = loopcal("export", recording, "-o", there)
    assert (outcome.exit_code, there.read_text()) == (2, "mine")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(recording.read_bytes()[:-500])
    outcome = loopcal("export", damaged, "-o", tmp_path / "b.csv")
    assert outcome.exit_code == 2
    assert "is damaged" in outcome.stderr
    assert not (tmp_path / "b.csv").exists()
