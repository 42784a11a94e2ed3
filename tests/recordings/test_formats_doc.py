"""docs/formats.md says the truth: its messages, its script and its keys are the program's."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import recordings
from recordings import codec
from recordings.reader import read_recording
from recordings.rig import CanPort, Plan, Rig, SerialPort, TcpPort
from recordings.rig.instruments import Channel, Device
from recordings.rig.interlocks import Interlocks, JointInterlock, Together
from recordings.rig.mechanism import (
    CONSTRAINTS,
    Closure,
    Distance,
    Fixture,
    Joint,
    Leg,
    Neutral,
    PlatformMechanism,
    Point,
    SerialMechanism,
    Tip,
)
from recordings.rig.plan import Revisit
from recordings.rig.quantity import Described
from recordings.rig.tracker import Marker, Tracker
from recordings.session import Session, to_metadata

ROOT = Path(recordings.__file__).parent.parent
DOC = (ROOT / "docs" / "formats.md").read_text("utf-8")

# Where the keys of each table of a rig file are listed: the words in front of its key table.
TABLES: dict[type[Described], str] = {
    Rig: "## Top level",
    SerialMechanism: "## `[mechanism]` of family `serial`",
    Joint: "`[[mechanism.joint]]`:",
    Tip: "`tip`:",
    Fixture: "`[[mechanism.fixture]]`:",
    Distance: "`[[mechanism.distance]]`:",
    Closure: "`closure`:",
    PlatformMechanism: "## `[mechanism]` of family `platform`",
    Point: "`[[mechanism.base_point]]` and",
    Leg: "`[[mechanism.leg]]`:",
    Neutral: "`neutral`:",
    Channel: "## `[[channel]]`",
    Tracker: "## `[[tracker]]`",
    Marker: "`[[tracker.marker]]`:",
    CanPort: "A CAN bus:",
    SerialPort: "A serial line:",
    TcpPort: "A TCP connection:",
    Device: "## `[[device]]`",
    Plan: "## `[plan]`",
    Revisit: "`revisit`:",
    Interlocks: "## `[interlocks]`",
    JointInterlock: "`[[interlocks.joint]]`:",
    Together: "`[[interlocks.together]]`:",
}


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", DOC, re.MULTILINE | re.DOTALL)
    return str(found)


def rows(words: str) -> list[list[str]]:
    """Cells of the first table behind ``words`` at the beginning of a line."""
    start = DOC.index(f"\n{words}")
    table = re.search(r"^\|.*\n\|[-|]+\n((?:\|.*\n)+)", DOC[start:], re.MULTILINE)
    assert table is not None
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in table[1].splitlines()]


def models(model: Any) -> Iterator[type[Described]]:
    """``model`` and all tables within it."""
    if isinstance(model, type) and issubclass(model, Described):
        yield model
        for field in model.model_fields.values():
            yield from models(field.annotation)
    else:
        for inner in get_args(model):
            yield from models(inner)


def test_the_messages_are_those_of_the_program() -> None:
    assert block("proto") == (ROOT / "recordings" / "messages.proto").read_text("utf-8")


def test_the_topics_are_those_of_the_program() -> None:
    expected = [
        (f"`{kind.topic(f'<{kind.subject}>' if kind.subject else '')}`", f"`{kind.schema_name}`")
        for kind in codec.KINDS
    ]
    assert [(topic, message) for topic, message, _ in rows("## Topics")] == expected


def test_the_session_keys_are_those_of_the_program() -> None:
    assert {key.strip("`") for key, _ in rows("## Session")} == set(to_metadata(Session()))


def test_every_table_of_a_rig_file_is_described() -> None:
    assert set(models(Rig)) == set(TABLES)


@pytest.mark.parametrize("model", TABLES, ids=lambda model: model.__name__)
def test_every_key_of_a_rig_file_is_described(model: type[Described]) -> None:
    expected: list[str] = []
    required: dict[str, bool] = {}
    for name, field in model.model_fields.items():
        units = model.quantities.get(name)
        keys = [field.alias or name] if units is None else [f"{name}_{unit}" for unit in units]
        expected += keys
        required |= dict.fromkeys(keys, field.is_required())
    described = rows(TABLES[model])
    found = [key.strip("`") for row in described for key in row[0].split(", ")]
    assert sorted(found) == sorted(expected)
    for row in described:
        for key in row[0].split(", "):
            assert (row[2] == "required") == required[key.strip("`")], key


@pytest.mark.parametrize("model", TABLES, ids=lambda model: model.__name__)
def test_plain_defaults_are_the_programs(model: type[Described]) -> None:
    for row in rows(TABLES[model]):
        name = row[0].split(", ")[0].strip("`")
        for field_name, field in model.model_fields.items():
            if name in (field_name, field.alias) and isinstance(field.default, int | str | float):
                shown = row[2].strip("`").strip('"')
                default = str(field.default)
                assert shown == (default.lower() if isinstance(field.default, bool) else default), (
                    name
                )
            unit = name.removeprefix(f"{field_name}_")
            if unit in model.quantities.get(field_name, ()) and isinstance(field.default, float):
                assert float(row[2].split()[0]) == field.default, name


def test_the_constraints_are_the_programs() -> None:
    (row,) = (row for row in rows("`closure`:") if row[0] == "`constraint`")
    names = re.findall(r'"(\w+)"', row[1])
    free = [set(re.findall(r"`(\w+)`", part)) for part in row[3].split(": ")[1].split("; ")]
    assert dict(zip(names, free, strict=True)) == {**CONSTRAINTS, "custom": {"free"}}


def test_the_headings_are_those_that_others_link_to() -> None:
    headings = re.findall(r"^# (.*)$", re.sub(r"```.*?```", "", DOC, flags=re.DOTALL), re.MULTILINE)
    assert headings == [
        "File formats",
        "Recordings",
        "Rig files",
        "Result files",
        "Gap files",
        "Info and doctor files",
        "Correction files",
    ]


def test_the_script_of_another_program_makes_a_recording(tmp_path: Path, rig_toml: str) -> None:
    """It runs on nothing but what the document gives, mcap and protobuf."""
    (tmp_path / "messages.proto").write_text(block("proto"), "utf-8")
    (tmp_path / "write_recording.py").write_text(block("python"), "utf-8")
    (tmp_path / "bench.toml").write_bytes(rig_toml.encode())
    time_ns = 1_700_000_000_000_000_000 + np.arange(500) * 10_000_000
    counts = {"q1": np.arange(500) - 250, "q2": np.arange(500) ** 2}
    with (tmp_path / "counts.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_ns", *counts])
        table.writerows(zip(time_ns, *counts.values(), strict=True))
    protoc = ["-m", "grpc_tools.protoc", "-I.", "--python_out=.", "messages.proto"]
    script = ["write_recording.py", "bench.toml", "counts.csv", "out.mcap"]
    for arguments in (protoc, script):
        command = [sys.executable, "-W", "error", *arguments]
        subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    recording = read_recording(tmp_path / "out.mcap")
    assert recording.rig_toml == rig_toml
    for name, expected in counts.items():
        assert recording.readings[name].time_ns.tolist() == time_ns.tolist()
        assert recording.readings[name].raw.tolist() == expected.tolist()
    assert recording.damage == ()
