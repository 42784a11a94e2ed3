"""A disk that fills up: the file stays readable, and what did not get into it is in its ledger."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from recordings.errors import DiskFailed, RecordingError
from recordings.events import Dwell, LedgerEntry, Reading
from recordings.reader import read_recording
from recordings.session import Session
from recordings.storage import RecordingFile, Storage, Sync, room_in
from recordings.writer import Writer

START_NS = 1_700_000_000_000_000_000
OPEN = RecordingFile.__init__


class SmallDisk:
    """A raw file on a disk that has room for ``room`` bytes: it takes what fits, then fails."""

    def __init__(self, file: Any, room: int, code: int) -> None:
        self._file = file
        self._room = room
        self._code = code

    def write(self, data: memoryview) -> int:
        free = self._room - self._file.tell()
        if free <= 0:
            raise OSError(self._code, "no")
        return int(self._file.write(data[:free]))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def shrink_disk(
    patch: pytest.MonkeyPatch, room: int, code: int = errno.ENOSPC, *, seen: bool = False
) -> None:
    """Let every file that is opened from now on be on a disk of its own, of this size.

    Unless ``seen``, the system says that there is room, as it does when others fill the disk.
    """

    def opened(self: RecordingFile, path: Path, sync: Sync) -> None:
        OPEN(self, path, sync)
        self._file = SmallDisk(self._file, room, code)  # type: ignore[assignment]

    patch.setattr(RecordingFile, "__init__", opened)
    if seen:
        patch.setattr(RecordingFile, "room", lambda self: room - self._size)


def write_until_full(writer: Writer, *, ledger_by_caller: bool = False) -> tuple[int, DiskFailed]:
    """Readings of q1 handed over until the disk failed, and how it said so."""
    noise = np.random.default_rng(3).integers(-(2**40), 2**40, 5000)  # does not compress
    handed = 0
    try:
        for i in range(5000):
            handed += 1
            writer.write(Reading("q1", START_NS + i, int(noise[i])))
            if i % 7 == 0:
                writer.write(Dwell(START_NS + i, START_NS, START_NS + i, i, 0))
            if i % 50 == 49:
                if ledger_by_caller:
                    writer.write(LedgerEntry("q1", START_NS + i, handed + 5, handed, 2, 3, 0, 0))
                writer.flush()
    except DiskFailed as error:
        return handed, error
    raise AssertionError("the disk never filled up")


def test_wherever_the_disk_ends_the_file_is_read_and_the_ledger_adds_up(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(5)
    for number, room in enumerate(rng.integers(80_000, 130_000, 40).tolist()):
        seen = number % 4 < 2
        path = tmp_path / f"{number}.mcap"
        by_caller = bool(number % 2)
        with monkeypatch.context() as patch:
            shrink_disk(patch, room, seen=seen)
            writer = Writer(path, rig_toml, session)
            handed, error = write_until_full(writer, ledger_by_caller=by_caller)
        writer.close()
        with pytest.raises(RecordingError, match="is closed"):
            writer.write(Reading("q1", START_NS, 1))
        assert path.stat().st_size <= room
        recording = read_recording(path, damaged_ok=True)
        present = len(recording.readings["q1"])
        assert present + error.lost["q1"] == handed, room
        assert "the disk is full" in str(error)
        if not seen:
            assert len(recording.damage) == 1, "the file ends inside a record"
            assert recording.damage[0].endswith("it was never closed, or cut")
            assert "could not be closed" in str(error)
            continue
        assert not recording.damage
        assert "was closed" in str(error)
        entry = recording.ledger["q1"]
        assert (entry.received, entry.unaccounted) == (present, 0)
        told = 3 if by_caller and handed > 50 else 0
        assert entry.dropped_by_host == error.lost["q1"] + told
        assert recording.faults[-1].kind == "disk"
        with path.open("rb") as file:
            assert make_reader(file, validate_crcs=True).get_summary() is not None


def test_many_readings_at_once_are_accounted_for(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shrink_disk(monkeypatch, 300_000)
    raw = np.random.default_rng(4).integers(-(2**62), 2**62, 50_000)
    writer = Writer(tmp_path / "a.mcap", rig_toml, session)
    with pytest.raises(DiskFailed) as caught:
        writer.write_readings("q1", START_NS + np.arange(50_000), raw)
    recording = read_recording(tmp_path / "a.mcap", damaged_ok=True)
    kept = recording.readings["q1"].raw
    assert 5_000 < len(kept) == 50_000 - caught.value.lost["q1"]
    assert np.array_equal(kept, raw[: len(kept)])


def test_a_file_that_may_not_grow_says_what_to_do(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shrink_disk(monkeypatch, 30_000, errno.EFBIG)
    _, error = write_until_full(Writer(tmp_path / "a.mcap", rig_toml, session))
    assert "no file may be larger here" in str(error)
    assert "--rotate-mb" in str(error)


def test_a_disk_without_room_for_the_beginning_gets_no_file(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shrink_disk(monkeypatch, 500)
    with pytest.raises(RecordingError, match=r"cannot create .*the disk is full"):
        Writer(tmp_path / "a.mcap", rig_toml, session)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_cannot_even_be_cut_back_is_left_alone(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A record that is there in part is damage, and nothing is written behind it."""
    shrink_disk(monkeypatch, 20_000)

    def refuse(self: SmallDisk, size: int) -> int:
        raise OSError(errno.EIO, "no")

    monkeypatch.setattr(SmallDisk, "truncate", refuse, raising=False)
    path = tmp_path / "a.mcap"
    handed, error = write_until_full(Writer(path, rig_toml, session))
    recording = read_recording(path, damaged_ok=True)
    assert path.stat().st_size == 20_000
    assert handed - error.lost["q1"] <= len(recording.readings["q1"]) <= handed


def test_a_nearly_full_disk_is_told_while_there_is_room(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = 50_000_000
    monkeypatch.setattr(RecordingFile, "room", lambda self: free)
    with Writer(
        tmp_path / "a.mcap", rig_toml, session, Storage(reserve_bytes=40_000_000)
    ) as writer:
        assert writer.nearly_full == ""
        free = 39_000_000
        told = writer.nearly_full
        writer.write(Reading("q1", START_NS, 1))
    assert "can grow by 39.0 MB, less than the reserve of 40.0 MB" in told
    assert len(read_recording(tmp_path / "a.mcap").readings["q1"]) == 1


def test_room_is_that_of_the_disk(tmp_path: Path) -> None:
    assert room_in(tmp_path) > 1_000_000


LIMITED = """
import json, resource, sys
from pathlib import Path
from recordings.errors import DiskFailed
from recordings.events import Reading
from recordings.session import Session
from recordings.writer import Writer

resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
path, rig = sys.argv[1:]
writer = Writer(path, Path(rig).read_text(), Session(start_ns=1))
handed = 0
told = writer.nearly_full
try:
    while True:
        handed += 1
        writer.write(Reading("q1", handed, handed * 6364136223846793005 % 2**62))
        if handed % 100 == 0:
            writer.flush()
except DiskFailed as error:
    print(json.dumps({"handed": handed, "lost": error.lost, "text": str(error), "told": told}))
"""


def test_the_limit_of_a_process_is_met_like_a_full_disk(tmp_path: Path, rig_toml: str) -> None:
    """The real thing: the system cuts the write short and refuses the next."""
    path, rig = tmp_path / "a.mcap", tmp_path / "rig.toml"
    rig.write_text(rig_toml)
    ran = subprocess.run(
        [sys.executable, "-c", LIMITED, path, rig], capture_output=True, text=True, check=True
    )
    said = json.loads(ran.stdout)
    assert "can grow by 0.1 MB" in said["told"]
    assert "no file may be larger here" in said["text"]
    recording = read_recording(path)
    assert len(recording.readings["q1"]) + said["lost"]["q1"] == said["handed"]
    assert recording.ledger["q1"].unaccounted == 0
    assert path.stat().st_size <= 100_000


def test_a_folder_that_is_moved_away_does_not_end_the_recording(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    (tmp_path / "here").mkdir()
    with Writer(tmp_path / "here" / "a.mcap", rig_toml, session) as writer:
        writer.write(Reading("q1", START_NS, 1))
        (tmp_path / "here").rename(tmp_path / "there")
        writer.flush()
        assert writer.nearly_full == ""
    assert len(read_recording(tmp_path / "there" / "a.mcap").readings["q1"]) == 1
