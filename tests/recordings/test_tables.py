"""Tables of poses become recordings that say the same, or an error says where they do not."""

from __future__ import annotations

from pathlib import Path

import pytest

from recordings.errors import TableError
from recordings.reader import read_recording
from recordings.rig import parse_rig
from recordings.tables import Table, import_tables

RIG = """
schema = 1
name = "two"
[mechanism]
family = "serial"
closure = { constraint = "ball" }
[[mechanism.joint]]
name = "turn"
[[mechanism.joint]]
name = "slide"
type = "prismatic"
[[mechanism.fixture]]
name = "left"
[[mechanism.fixture]]
name = "right"
[[channel]]
name = "q1"
senses = "turn"
gain_rad_per_count = 1e-9
[[channel]]
name = "q2"
senses = "slide"
gain_m_per_count = 1e-6
offset_m = 0.1
zero_count = 7
"""


def write(path: Path, text: str) -> Table:
    path.write_text(text, "utf-8")
    return Table(path)


def test_rows_become_dwells_of_their_fixture(tmp_path: Path) -> None:
    named = write(
        tmp_path / "a.csv", "q2_mm,q1_deg,fixture,direction\n150,180,right,up\n\n100,0,left,\n"
    )
    bare = write(tmp_path / "left.csv", "0.25,0.2\n")
    with pytest.raises(TableError, match="expected <channel>_<unit>"):
        import_tables(parse_rig(RIG), RIG, [named, bare], tmp_path / "x.mcap")
    first, second = tmp_path / "1.mcap", tmp_path / "2.mcap"
    assert import_tables(parse_rig(RIG), RIG, [named], first) == 2
    assert import_tables(parse_rig(RIG), RIG, [bare], second, columns=["q1_rad", "q2_m"]) == 1
    recording = read_recording(first)
    assert recording.rig_toml == RIG
    assert recording.readings["q1"].raw.tolist() == [3141592654, 0]
    assert recording.readings["q2"].raw.tolist() == [50007, 7]
    assert [(d.pose, d.visit, d.fixture) for d in recording.dwells] == [
        (0, 0, "right"),
        (1, 0, "left"),
    ]
    assert [mark.text for mark in recording.marks] == ["pose 0, visit 0: direction up"]
    assert read_recording(second).dwells[0].fixture == "left"


def test_visits_return_to_their_poses(tmp_path: Path) -> None:
    table = write(tmp_path / "left.csv", "q1_rad,q2_counts,visit\n0,1,0\n1,2,0\n0,1,1\n1,2,1\n")
    import_tables(parse_rig(RIG), RIG, [table], tmp_path / "out.mcap")
    dwells = read_recording(tmp_path / "out.mcap").dwells
    assert [(d.pose, d.visit) for d in dwells] == [(0, 0), (1, 0), (0, 1), (1, 1)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("q1_rad\n1\n", "0 columns of channel 'q2'"),
        ("q1_rad,q2_rad\n1,1\n", "expected m, mm, counts"),
        ("q1_rad,q2_m\n1\n", "line 2 of .* has 1 columns, expected 2"),
        ("q1_rad,q2_m,fixture\n1,x,left\n", "'x' for q2, expected a number"),
        ("q1_rad,q2_m,fixture\nnan,1,left\n", "beyond what counts hold"),
        ("q1_rad,q2_m\n1,1\n", "no fixture, expected one of: left, right"),
        ("q1_rad,q2_m,fixture\n1,1,top\n", "the fixture 'top', expected one of"),
        ("q1_rad,q2_m,fixture,visit\n1,1,left,-1\n", "'-1' for visit"),
        ("q1_rad,q2_m\n", "no rows"),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, text: str, message: str) -> None:
    table = write(tmp_path / "table.csv", text)
    with pytest.raises(TableError, match=message):
        import_tables(parse_rig(RIG), RIG, [table], tmp_path / "out.mcap")
    with pytest.raises(TableError, match="cannot read the table"):
        import_tables(parse_rig(RIG), RIG, [Table(tmp_path / "none.csv")], tmp_path / "out.mcap")
