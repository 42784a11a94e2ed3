"""A rig and the files that its devices name travel as one text."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recordings.errors import RigError
from recordings.rig import load_rig, parse_rig, rig_text
from recordings.rig.files import _quoted

RIG = """schema = 1
name = "one"
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "joint1"
[[channel]]
name = "q1"
senses = "joint1"
device = "e1"
gain_deg_per_count = 0.001
[[port]]
kind = "can"
name = "bus"
interface = "virtual"
channel = "x"
[[device]]
name = "e1"
driver = "dbc-encoder"
port = "bus"
file = "sub/e1.dbc"
"""
DBC = 'VERSION ""\r\nCM_ "100 \xb5s, 4 \\ 5";\r\n'


def write(folder: Path, text: str = RIG, dbc: bytes | None = DBC.encode("cp1252")) -> str:
    if dbc is not None:
        (folder / "sub").mkdir()
        (folder / "sub" / "e1.dbc").write_bytes(dbc)
    (folder / "rig.toml").write_text(text, "utf-8")
    return str(folder / "rig.toml")


def test_the_text_of_a_rig_holds_the_files_of_its_devices(tmp_path: Path) -> None:
    path = write(tmp_path)
    text, source = rig_text(path)
    assert text.startswith(RIG)
    rig = parse_rig(text, source)
    assert rig.files == {"sub/e1.dbc": DBC.replace("\r\n", "\n")}
    assert rig.files == load_rig(path).files
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "again.toml").write_text(text, "utf-8")
    assert rig_text(str(tmp_path / "elsewhere" / "again.toml"))[0] == text


def test_a_rig_that_names_no_file_is_taken_byte_for_byte(tmp_path: Path) -> None:
    text = RIG.replace('file = "sub/e1.dbc"\n', "") + "\n\n# end"
    assert rig_text(write(tmp_path, text, None))[0] == text


@pytest.mark.parametrize(
    ("text", "dbc", "words"),
    [
        (RIG, None, "cannot read .*e1.dbc.*relative to the rig file"),
        (RIG, b"\x81\x8d\xff\xfe", "is no text in utf-8 or cp1252"),
        (RIG + "[files]\nother = 1\n", b"x", "has a table .files., but not the file"),
    ],
)
def test_a_file_that_is_not_there_is_named(tmp_path: Path, text, dbc, words) -> None:
    with pytest.raises(RigError, match=words):
        rig_text(write(tmp_path, text, dbc))


def test_a_text_without_its_files_is_refused() -> None:
    with pytest.raises(RigError, match=r"described by the file 'sub/e1\.dbc', expected one of"):
        parse_rig(RIG)


@settings(deadline=None, derandomize=True)
@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cs"])))
def test_any_text_survives_quoting(text: str) -> None:
    assert tomllib.loads(f"x = {_quoted(text)}")["x"] == text
