"""Recovery: all that can be read, in its order, in a whole file; the damaged one is untouched."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from recordings import messages_pb2
from recordings.chunks import scan
from recordings.codec import READING, schema_data
from recordings.errors import (
    HopelessRecording,
    NotARecording,
    NothingReadable,
    RecordingError,
    RecordingsError,
    RigError,
)
from recordings.events import Dwell, Mark, Reading
from recordings.items import Block
from recordings.reader import read_recording
from recordings.recover import recover
from recordings.session import Session
from recordings.storage import Storage
from recordings.survey import survey
from recordings.writer import Writer

START_NS = 1_700_000_000_000_000_000
COUNT = 400


@dataclass(frozen=True)
class Sample:
    """A file of 20 small chunks; reading i of q1 has the count i, and q2 has every second."""

    data: bytes
    places: tuple[int, ...]  # where each record begins


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    rig = """
schema = 1
name = "bench"
mechanism = { family = "serial", joint = [{ name = "base", a_m = 0.3 }, { name = "elbow", a_m = 0.3 }] }
channel = [
    { name = "q1", senses = "base", gain_deg_per_count = 0.01 },
    { name = "q2", senses = "elbow", gain_deg_per_count = 0.01 },
]
"""
    path = tmp_path_factory.mktemp("sample") / "whole.mcap"
    with Writer(path, rig, Session("s", START_NS, "Ada")) as writer:
        for i in range(COUNT):
            writer.write(Reading("q1", START_NS + i * 1000, i, sequence=i))
            if i % 2:
                writer.write(Reading("q2", START_NS + i * 1000, i // 2))
            if i % 100 == 99:
                writer.write(Dwell(START_NS + i * 1000, START_NS, START_NS + i, i // 100, 0))
                writer.write(Mark(START_NS + i * 1000, "x" * i))
            if i % 20 == 19:
                writer.flush()
    data = path.read_bytes()
    places, at = [], 8
    while at < len(data) - 8:
        places.append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    assert at == len(data) - 8
    return Sample(data, tuple(places))


def check(sample: Sample, data: bytes, folder: Path) -> int:
    """Recover ``data``, compare with what is read of it and with the truth; readings of q1 left."""
    for path in folder.glob("*.mcap"):
        path.unlink()
    source, target = folder / "damaged.mcap", folder / "new.mcap"
    source.write_bytes(data)
    left = read_recording(source, damaged_ok=True)
    done = recover(source, target)
    assert source.read_bytes() == data
    whole = read_recording(target)
    assert whole.rig_toml == left.rig_toml
    assert (whole.dwells, whole.marks, whole.ledger) == (left.dwells, left.marks, left.ledger)
    assert bool(left.damage) == bool(done.found.damage)
    for name in ("q1", "q2"):
        raw = left.readings[name].raw
        assert np.array_equal(whole.readings[name].raw, raw)
        if len(raw) == 0:
            continue
        # What is said to be missing is exactly what is: up to the last that is known of.
        tally = done.found.channel(name)
        missing = {hole.first + k for hole in tally.holes for k in range(hole.count)}
        assert tally.next is not None
        assert missing == set(range(tally.next)) - set(raw.tolist())
        assert survey(target).channel(name).missing == tally.missing == len(missing)
    return len(left.readings["q1"])


def test_a_whole_file_is_copied_with_nothing_missing(sample: Sample, tmp_path: Path) -> None:
    assert check(sample, sample.data, tmp_path) == COUNT
    done = survey(tmp_path / "new.mcap")
    assert done.damage == ()
    assert done.session.operator == "Ada"
    assert done.recovery["source"] == "damaged.mcap"


def test_a_cut_at_every_record_and_inside_costs_only_what_is_behind(
    sample: Sample, tmp_path: Path
) -> None:
    rng = np.random.default_rng(21)
    first_chunk = sample.data.index(b"\x04\0\0\0zstd") - 37
    cuts = [place for place in sample.places if place > first_chunk][::4]
    cuts += rng.integers(first_chunk, len(sample.data), 15).tolist()
    before = 0
    for cut in sorted(cuts):
        left = check(sample, sample.data[:cut], tmp_path)
        assert before <= left <= COUNT
        before = left
    assert before == COUNT


def test_flipped_bits_cost_their_chunks_and_are_counted(sample: Sample, tmp_path: Path) -> None:
    rng = np.random.default_rng(22)
    for _ in range(25):
        data = bytearray(sample.data)
        places = rng.integers(0, len(data), int(rng.integers(1, 5))).tolist()
        for place in places:
            data[place] ^= 1 << int(rng.integers(8))
        assert check(sample, bytes(data), tmp_path) >= COUNT - 20 * len(places)


def test_holes_cost_what_they_cover(sample: Sample, tmp_path: Path) -> None:
    rng = np.random.default_rng(23)
    for _ in range(25):
        start = int(rng.integers(2_000, len(sample.data)))
        size = int(rng.integers(1, 3_000))
        data = sample.data[:start] + bytes(size) + sample.data[start + size :]
        check(sample, data, tmp_path)


def test_a_tail_of_zeros_costs_nothing_before_it(sample: Sample, tmp_path: Path) -> None:
    """What a file system leaves where it had not yet written what was appended."""
    cut = 2 * len(sample.data) // 3
    assert check(sample, sample.data[:cut] + bytes(50_000), tmp_path) > COUNT // 2


def test_the_mcap_library_reads_what_was_recovered_and_would_have_stopped(
    sample: Sample, tmp_path: Path
) -> None:
    data = bytearray(sample.data)
    third = [place for place in sample.places if data[place] == 6][2]
    data[third + 60] ^= 0x10
    by_library: list[int] = []
    with pytest.raises((McapError, zstandard.ZstdError)):
        by_library.extend(
            record.log_time
            for record in StreamReader(io.BytesIO(bytes(data)), validate_crcs=True).records
            if isinstance(record, Message)
        )
    check(sample, bytes(data), tmp_path)
    with (tmp_path / "new.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        found = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
        assert len(found) == summary.statistics.message_count
        ordered = [message.log_time for _, _, message in reader.iter_messages()]
        assert ordered == sorted(found)
    with (tmp_path / "new.mcap").open("rb") as file:
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == len(
            found
        )
    assert len(by_library) < 100 < 600 < len(found)


def test_messages_keep_their_order_and_their_bytes(sample: Sample, tmp_path: Path) -> None:
    data = bytearray(sample.data)
    data[len(data) // 2] ^= 1
    check(sample, bytes(data), tmp_path)

    def messages(path: Path) -> bytes:
        out = b""
        with path.open("rb") as file:
            for item in scan(file, path.stat().st_size):
                if isinstance(item, Block):
                    at = 0
                    while at < len(item.data):
                        end = at + 9 + int.from_bytes(item.data[at + 1 : at + 9], "little")
                        out += item.data[at:end] if item.data[at] == 5 else b""
                        at = end
        return out

    assert messages(tmp_path / "new.mcap") == messages(tmp_path / "damaged.mcap")


@pytest.mark.parametrize("compression", list(CompressionType))
def test_what_others_put_into_a_recording_is_kept(
    tmp_path: Path, rig_toml: str, compression: CompressionType
) -> None:
    stream = io.BytesIO()
    writer = McapWriter(stream, chunk_size=400, compression=compression)
    writer.start(profile="loopcal", library="other 1")
    writer.add_attachment(0, 0, "rig.toml", "application/toml", rig_toml.encode())
    writer.add_attachment(0, 0, "photo.jpg", "image/jpeg", b"photo")
    writer.add_metadata("weather", {"sky": "blue"})
    kind = writer.register_schema("loopcal.Reading", "protobuf", schema_data(READING))
    plain = writer.register_schema("sky", "jsonschema", b"{}")
    q1 = writer.register_channel("/channel/q1", "protobuf", kind)
    sky = writer.register_channel("/camera/sky", "json", plain, {"lens": "wide"})
    for i in range(100):
        reading = messages_pb2.Reading(raw=i).SerializeToString()
        writer.add_message(q1, i, reading, i)
        writer.add_message(sky, i, json.dumps(i).encode(), i)
    writer.finish()
    path = tmp_path / "other.mcap"
    path.write_bytes(stream.getvalue()[: -len(stream.getvalue()) // 3])
    done = recover(path, tmp_path / "new.mcap")
    count = len(read_recording(tmp_path / "new.mcap").readings["q1"])
    assert 20 < count < 100
    # Its sequence numbers are all 0, so nothing tells how much is lost.
    assert done.found.channel("q1").missing is None
    with (tmp_path / "new.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        skies = list(reader.iter_messages(topics="/camera/sky"))
        attachments = {each.name: each.data for each in reader.iter_attachments()}
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}
    assert count - 10 < len(skies) < count + 10
    schema, channel, _ = skies[0]
    assert schema is not None
    assert (schema.name, channel.metadata) == ("sky", {"lens": "wide"})
    assert [json.loads(message.data) for _, _, message in skies] == list(range(len(skies)))
    assert attachments["photo.jpg"] == b"photo"
    assert metadata["weather"] == {"sky": "blue"}
    assert metadata["loopcal.recovery"]["library"] == "other 1"


def test_all_parts_become_one(tmp_path: Path, rig_toml: str, session: Session) -> None:
    with Writer(tmp_path / "run.mcap", rig_toml, session, Storage(rotate_s=1e-6)) as writer:
        for i in range(100):
            writer.write(Reading("q1", session.start_ns + i * 100, i))
            if i % 10 == 9:
                writer.flush()
    assert len(writer.paths) > 4
    second = writer.paths[1]
    data = bytearray(second.read_bytes())
    data[data.rindex(b"\x04\0\0\0zstd", 0, len(data) // 2) + 30] ^= 1
    second.write_bytes(data)
    lost = 100 - len(read_recording(tmp_path / "run.mcap", damaged_ok=True).readings["q1"])
    assert lost > 0
    done = recover(tmp_path / "run.mcap", tmp_path / "new.mcap")
    assert done.found.channel("q1").missing == lost
    whole = read_recording(tmp_path / "new.mcap")
    assert len(whole.readings["q1"]) == 100 - lost
    assert whole.part.number == 1
    # Without a part in the middle, what it held is counted too.
    second.unlink()
    found = survey(tmp_path / "run.mcap")
    assert "part 2 and what may follow it is missing" in found.missing_part


def test_a_recovered_recording_can_be_recovered(sample: Sample, tmp_path: Path) -> None:
    data = bytearray(sample.data)
    data[len(data) // 2] ^= 1
    check(sample, bytes(data), tmp_path)
    again = bytearray((tmp_path / "new.mcap").read_bytes())
    again[len(again) // 3] ^= 1
    (tmp_path / "again.mcap").write_bytes(again)
    recover(tmp_path / "again.mcap", tmp_path / "newer.mcap")
    found = survey(tmp_path / "newer.mcap")
    assert found.recovery["earlier/source"] == "damaged.mcap"
    assert found.recovery["library"].startswith("loopcal ")
    left = read_recording(tmp_path / "again.mcap", damaged_ok=True).readings["q1"].raw
    assert np.array_equal(read_recording(tmp_path / "newer.mcap").readings["q1"].raw, left)
    assert found.channel("q1").missing == COUNT - len(left)


def test_a_lost_rig_can_be_given(
    sample: Sample, tmp_path: Path, rig_toml: str, write_session: Callable[..., Path]
) -> None:
    path = write_session(tmp_path / "a.mcap")
    data = path.read_bytes().replace(b"elbow", b"knee!")  # both copies: their CRCs are wrong now
    path.write_bytes(data)
    with pytest.raises(HopelessRecording, match="rig description is lost, everywhere"):
        recover(path, tmp_path / "new.mcap")
    with pytest.raises(RigError):
        recover(path, tmp_path / "new.mcap", rig_toml="nonsense")
    assert not (tmp_path / "new.mcap").exists()
    recover(path, tmp_path / "new.mcap", rig_toml=rig_toml)
    whole = read_recording(tmp_path / "new.mcap")
    assert (whole.rig_toml, len(whole.readings["q1"])) == (rig_toml, 300)
    assert survey(tmp_path / "new.mcap").recovery["rig"] == "given"


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", NothingReadable),
        (b"plain text " * 100, NothingReadable),
        (b"\x89MCAP0\r\n", HopelessRecording),
        (bytes(100_000), NothingReadable),
    ],
)
def test_what_is_hopeless_is_said_to_be(
    tmp_path: Path, data: bytes, error: type[RecordingsError]
) -> None:
    (tmp_path / "a.mcap").write_bytes(data)
    with pytest.raises(error):
        recover(tmp_path / "a.mcap", tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        writer.finish()
    with pytest.raises(NotARecording, match="profile 'ros2'") as caught:
        recover(tmp_path / "a.mcap", tmp_path / "new.mcap")
    assert not isinstance(caught.value, NothingReadable)
    with pytest.raises(NotARecording, match="there is no file"):
        recover(tmp_path / "none.mcap", tmp_path / "new.mcap")


def test_nothing_is_overwritten(sample: Sample, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(sample.data)
    (tmp_path / "b.mcap").write_bytes(b"precious")
    for target in ("a.mcap", "b.mcap"):
        with pytest.raises(RecordingError, match="exists already"):
            recover(tmp_path / "a.mcap", tmp_path / target)
    assert (tmp_path / "a.mcap").read_bytes() == sample.data
    assert (tmp_path / "b.mcap").read_bytes() == b"precious"


def test_what_a_recovery_notes_is_documented(sample: Sample, tmp_path: Path) -> None:
    data = bytearray(sample.data)
    data[len(data) // 2] ^= 1
    check(sample, bytes(data), tmp_path)
    doc = (Path(__file__).parents[2] / "docs" / "formats.md").read_text("utf-8")
    noted = survey(tmp_path / "new.mcap").recovery
    assert {key.split("/")[0] for key in noted} >= {"source", "library", "damage", "rig"}
    for key in noted:
        name, _, rest = key.partition("/")
        assert f"| `{name}/<topic>` |" in doc if rest else f"| `{name}` |" in doc, key


@pytest.mark.parametrize("copies", [1, 2])
def test_a_damaged_word_on_the_session_does_not_damage_what_is_recovered(
    sample: Sample, tmp_path: Path, copies: int
) -> None:
    """Metadata has no CRC: a digit of the start becomes a control character, in one copy or in both."""
    start = str(START_NS).encode()
    assert sample.data.count(start) == 2
    path, saved = tmp_path / "damaged.mcap", tmp_path / "saved.mcap"
    path.write_bytes(sample.data.replace(start, start[:7] + b"\x10" + start[8:], copies))
    assert "invalid literal" in survey(path).damage[0]
    recover(path, saved)
    recording = read_recording(saved)
    assert recording.session.operator == "Ada"
    assert recording.session.start_ns == (START_NS if copies == 1 else 0)
    assert len(recording.readings["q1"]) == COUNT
