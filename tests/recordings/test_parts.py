"""A recording in several files: each is one of its own, and the first stands for all."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from recordings.errors import DamagedRecording, RecordingError
from recordings.events import Dwell, Event, LedgerEntry, Mark, Reading
from recordings.part import part_path
from recordings.reader import read_recording
from recordings.session import Session
from recordings.storage import Storage
from recordings.survey import survey
from recordings.writer import Writer

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000


@pytest.fixture
def write_parts(rig_toml: str, session: Session) -> Callable[..., tuple[Path, ...]]:
    """Writes 10 s at 100 Hz, in parts of 3 s unless told; returns the files."""

    def write(path: Path, storage: Storage | None = None) -> tuple[Path, ...]:
        with Writer(path, rig_toml, session, storage or Storage(rotate_s=3)) as writer:
            for i in range(1000):
                t = START_NS + i * STEP_NS
                writer.write(Reading("q1", t, 1000 + i, 500 + i, i))
                if i % 2:
                    writer.write(Reading("q2", t + 1, -i))
                if i % 100 == 99:
                    writer.write(Dwell(t + 2, t - STEP_NS, t, i // 100, 0))
                    writer.flush(t + 3)
        return writer.paths

    return write


def test_parts_are_read_as_the_one_file_they_would_be(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    assert [path.name for path in paths] == [
        "run.mcap",
        "run.002.mcap",
        "run.003.mcap",
        "run.004.mcap",
    ]
    assert sorted(tmp_path.iterdir()) == sorted(paths)
    (single,) = write_parts(tmp_path / "single.mcap", Storage())
    one, several = read_recording(single), read_recording(paths[0])
    for name in ("q1", "q2"):
        for column in ("time_ns", "raw", "device_time_ns", "sequence", "flags"):
            expected = getattr(one.readings[name], column)
            found = getattr(several.readings[name], column)
            assert (found is None) == (expected is None)
            if expected is not None:
                assert np.array_equal(found, expected)
                assert not found.flags.writeable
    assert several.dwells == one.dwells
    assert several.ledger == one.ledger
    assert several.session == one.session


def test_each_part_is_a_recording_that_others_read(
    tmp_path: Path, rig_toml: str, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    seen = entries = 0
    for number, path in enumerate(paths, start=1):
        if number > 1:
            alone = read_recording(path)
            assert alone.rig_toml == rig_toml
            assert (alone.part.number, alone.part.previous_file) == (number, paths[number - 2].name)
            assert alone.part.received_before == {"q1": seen, "q2": seen // 2}
            assert alone.readings["q1"].raw[0] == 1000 + seen
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            messages = list(reader.iter_messages(topics="/channel/q1"))
            ledger = list(reader.iter_messages(topics="/ledger/q1"))
            assert reader.get_summary().statistics.message_count == sum(
                1 for _ in reader.iter_messages()
            )
        # Sequence numbers and the ledger go on from part to part.
        for found, before in ((messages, seen), (ledger, entries)):
            numbers = [message.sequence for _, _, message in found]
            assert numbers == list(range(before, before + len(found)))
        seen += len(messages)
        entries += len(ledger)
    assert seen == 1000


def test_a_part_ends_at_its_size_too(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap", Storage(rotate_bytes=12_000))
    sizes = [path.stat().st_size for path in paths]
    assert len(paths) > 3
    assert min(sizes[:-1]) >= 12_000
    assert max(sizes) < 24_000
    assert len(read_recording(paths[0]).readings["q1"]) == 1000


def test_a_tiny_size_gives_a_chunk_a_part_and_no_endless_row_of_files(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap", Storage(rotate_bytes=1))
    assert len(paths) == 11
    assert len(read_recording(paths[0]).readings["q1"]) == 1000


def test_losses_are_counted_through_all_parts(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    with Writer(tmp_path / "run.mcap", rig_toml, session, Storage(rotate_s=1)) as writer:
        for second in range(4):
            t = START_NS + second * 1_000_000_000
            writer.write(Reading("q1", t, second))
            writer.account("q1", expected=10 * (second + 1), dropped_by_device=9 * (second + 1))
            writer.write(LedgerEntry("q2", t, second, 0, 0, second, 0, 0))
            writer.flush()
    assert len(writer.paths) == 4
    whole = read_recording(tmp_path / "run.mcap")
    assert whole.ledger["q1"].unaccounted == 0
    assert (whole.ledger["q1"].expected, whole.ledger["q1"].received) == (40, 4)
    middle = read_recording(writer.paths[2])
    assert (middle.ledger["q1"].received, middle.part.received_before["q1"]) == (4, 3)
    assert middle.ledger["q2"].dropped_by_host == 2


def test_a_missing_part_is_damage_and_the_rest_is_read(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    paths[2].rename(tmp_path / "away.mcap")
    with pytest.raises(DamagedRecording, match=r"part 3 .*missing: there is no file .*run\.003"):
        read_recording(paths[0])
    assert len(read_recording(paths[0], damaged_ok=True).readings["q1"]) == 601
    assert len(read_recording(paths[3]).readings["q1"]) == 1000 - 901


def test_damage_of_a_later_part_names_it(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    paths[3].write_bytes(paths[3].read_bytes()[:-40])
    with pytest.raises(DamagedRecording, match=r"run\.004\.mcap, byte"):
        read_recording(paths[0])


def test_a_part_of_another_session_is_not_taken(
    tmp_path: Path, rig_toml: str, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    with Writer(tmp_path / "other.mcap", rig_toml, Session("other")) as writer:
        writer.write(Reading("q1", START_NS, 1))
    shutil.copy(tmp_path / "other.mcap", paths[1])
    with pytest.raises(DamagedRecording, match=r"is part 1 of session 'other', expected part 2"):
        read_recording(paths[0])
    assert len(read_recording(paths[0], damaged_ok=True).readings["q1"]) == 301


def test_parts_renamed_alike_are_found(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    for number, path in enumerate(paths, start=1):
        path.rename(part_path(tmp_path / "monday.mcap", number))
    assert len(read_recording(tmp_path / "monday.mcap").readings["q1"]) == 1000


def test_parts_of_an_older_recording_are_refused_before_anything_is_written(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    (tmp_path / "run.007.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingError, match=r"run\.007\.mcap' exists already"):
        Writer(tmp_path / "run.mcap", rig_toml, session, Storage(rotate_s=3))
    assert [path.name for path in tmp_path.iterdir()] == ["run.007.mcap"]


def test_a_name_taken_meanwhile_ends_the_rotation_and_not_the_recording(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    events: list[Event] = [Mark(START_NS + i * 10**9, str(i)) for i in range(5)]
    with Writer(tmp_path / "run.mcap", rig_toml, session, Storage(rotate_s=2)) as writer:
        (tmp_path / "run.002.mcap").write_bytes(b"precious")
        for event in events:
            writer.write(event)
            writer.flush()
    assert (tmp_path / "run.002.mcap").read_bytes() == b"precious"
    recording = read_recording(tmp_path / "run.mcap")
    assert list(recording.marks) == events
    (fault,) = recording.faults
    assert "run.002.mcap' exists already" in fault.text


@pytest.mark.parametrize("wrong", [{"rotate_s": 0}, {"rotate_bytes": -1}, {"reserve_bytes": -1}])
def test_a_size_that_cannot_be_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(RecordingError, match="expected"):
        Storage(**wrong)


def test_a_wrong_bit_in_what_a_part_says_of_itself_costs_nothing(
    tmp_path: Path, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    data = paths[1].read_bytes()
    for said in (b"2023-11-14-a", b"part\x01\0\0\x002"):
        place = data.index(said) + len(said) - 1
        changed = bytearray(data)
        changed[place] ^= 1
        paths[1].write_bytes(changed)
        assert len(read_recording(paths[0], damaged_ok=True).readings["q1"]) == 1000
        found = survey(paths[0])
        assert found.damage
        assert found.channel("q1").count == 1000
        assert found.channel("q1").missing == 0


def test_a_survey_does_not_mix_sessions(
    tmp_path: Path, rig_toml: str, write_parts: Callable[..., tuple[Path, ...]]
) -> None:
    paths = write_parts(tmp_path / "run.mcap")
    with Writer(tmp_path / "other.mcap", rig_toml, Session("other")) as writer:
        writer.write(Reading("q1", START_NS, 1))
    shutil.copy(tmp_path / "other.mcap", paths[1])
    found = survey(paths[0])
    assert "is part 1 of session 'other', expected part 2" in found.missing_part
    assert found.channel("q1").count == 301


def test_a_topic_that_begins_in_a_later_part_is_counted_from_there(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    with Writer(tmp_path / "run.mcap", rig_toml, session, Storage(rotate_s=1)) as writer:
        for i in range(40):
            t = START_NS + i * 100_000_000
            writer.write(Reading("q1", t, i))
            if i > 25:
                writer.write(Reading("q2", t, i))
            writer.flush()
    found = survey(tmp_path / "run.mcap")
    assert (found.channel("q2").count, found.channel("q2").missing) == (14, 0)
