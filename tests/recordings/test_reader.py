"""What is read is what was written, whoever wrote it and however."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.decoder import DecoderFactory

from recordings import messages_pb2
from recordings.errors import DamagedRecording, NotARecording, RigError
from recordings.events import (
    ClockSample,
    Dwell,
    Event,
    Fault,
    Mark,
    ModeCommand,
    ModeReport,
    Reading,
    ReadingFlag,
    RoundTrip,
    StateChange,
)
from recordings.reader import Readings, Recording, read_recording
from recordings.session import Session
from recordings.writer import Writer

KINDS = (ModeCommand, ModeReport, Dwell, Mark, Fault, ClockSample, StateChange, RoundTrip)
TIME = st.integers(0, 2**63 - 1)
INT64 = st.integers(-(2**63), 2**63 - 1)
UINT32 = st.integers(0, 2**32 - 1)
READING = st.builds(
    Reading,
    st.sampled_from(["q1", "q2"]),
    TIME,
    INT64,
    st.none() | INT64,
    st.none() | UINT32,
    UINT32.map(ReadingFlag),
)


def events_of(recording: Recording) -> Iterator[Event]:
    yield from recording.mode_commands
    yield from recording.mode_reports
    yield from recording.dwells
    yield from recording.marks
    yield from recording.faults
    yield from recording.clock
    yield from recording.states
    yield from recording.round_trips


def assert_holds(found: Readings, expected: list[Reading]) -> None:
    """``found`` is exactly ``expected``, by the rules of `Readings`."""
    expected = sorted(expected, key=lambda reading: reading.time_ns)
    assert found.time_ns.tolist() == [reading.time_ns for reading in expected]
    assert found.raw.tolist() == [reading.raw for reading in expected]
    assert found.flags.tolist() == [reading.flags for reading in expected]
    for column, values in (
        (found.device_time_ns, [reading.device_time_ns for reading in expected]),
        (found.sequence, [reading.sequence for reading in expected]),
    ):
        if not values or None in values:
            assert column is None
        else:
            assert column is not None
            assert column.tolist() == values


@given(st.lists(READING, max_size=40))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_readings_come_back(rig_toml: str, readings: list[Reading]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        with Writer(path, rig_toml, Session()) as writer:
            for reading in readings:
                writer.write(reading)
        recording = read_recording(path)
    for channel in ("q1", "q2"):
        written = [reading for reading in readings if reading.channel == channel]
        assert_holds(recording.readings[channel], written)
        assert recording.ledger[channel].received == len(written)


def test_events_rig_and_session_come_back(
    tmp_path: Path, rig_toml: str, session: Session, one_of_each: tuple[Event, ...]
) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        for event in reversed(one_of_each):
            writer.write(event)
    recording = read_recording(path)
    assert list(events_of(recording)) == sorted(
        (event for event in one_of_each if not isinstance(event, Reading)),
        key=lambda event: (
            KINDS.index(type(event)),
            event.time_ns,
        ),
    )
    assert recording.rig_toml == rig_toml
    assert recording.rig.name == "bench"
    assert recording.session == session
    assert recording.path == path
    assert recording.damage == ()
    assert list(recording.ledger) == ["q1", "q2"]


def test_every_channel_of_the_rig_is_there_and_read_only(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    with Writer(tmp_path / "a.mcap", rig_toml, session) as writer:
        writer.write_readings("q2", [5, 3, 3], [1, 2, 3])
    readings = read_recording(tmp_path / "a.mcap").readings
    assert [len(found) for found in readings.values()] == [0, 3]
    assert readings["q2"].time_ns.tolist() == [3, 3, 5]
    assert readings["q2"].raw.tolist() == [2, 3, 1]
    with pytest.raises(ValueError, match="read-only"):
        readings["q2"].raw[0] = 9


def descriptor_set() -> bytes:
    described = FileDescriptorSet()
    messages_pb2.DESCRIPTOR.CopyToProto(described.file.add())
    return described.SerializeToString()


def reading_payloads(rng: np.random.Generator) -> Iterator[tuple[str, int, bytes]]:
    """Readings as other programs may write them: fields absent, in other order, unknown ones."""
    for i in range(400):
        message = messages_pb2.Reading(raw=int(rng.integers(-(2**40), 2**40)))
        if i % 7 < 3:
            message.device_time_ns = int(rng.integers(0, 2**62))
        if i % 5 < 3:
            message.sequence = i
        if i % 3:
            message.flags = i % 8
        payload = message.SerializeToString()
        if i % 11 == 0:  # an unknown field, number 15
            payload += b"\x7a\x03new"
        if i % 13 == 0:  # the same number twice: the later one counts
            payload += b"\x09" + (i).to_bytes(8, "little")
        if i % 17 == 0:  # flags before raw
            payload = b"\x25\x01\x00\x00\x00\x09" + (i).to_bytes(8, "little")
        yield f"q{1 + i % 2}", i // 2 * 1000, payload


def write_third_party(path: Path, rig_toml: str, **options: Any) -> None:
    rng = np.random.default_rng(5)
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="loopcal", library="someone else")
        writer.register_schema("other.Thing", "jsonschema", b"{}")
        schema = writer.register_schema("loopcal.Reading", "protobuf", descriptor_set())
        dwell = writer.register_schema("loopcal.Dwell", "protobuf", descriptor_set())
        ids = {
            name: writer.register_channel(f"/channel/{name}", "protobuf", schema)
            for name in ("q1", "q2")
        }
        other = writer.register_channel("/camera", "json", 1)
        for number, (name, time_ns, payload) in enumerate(reading_payloads(rng)):
            writer.add_message(ids[name], time_ns, payload, time_ns)
            if number == 100:
                writer.add_message(other, time_ns, b'{"a": 1}', time_ns)
                late = writer.register_channel("/session/dwell", "protobuf", dwell)
                message = messages_pb2.Dwell(start_ns=0, end_ns=time_ns, pose=0, visit=0)
                writer.add_message(late, time_ns, message.SerializeToString(), time_ns)
        writer.add_attachment(0, 0, "photo.jpg", "image/jpeg", bytes(100))
        writer.add_attachment(0, 0, "rig.toml", "application/toml", rig_toml.encode())
        writer.finish()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"chunk_size": 500},
        {"compression": CompressionType.LZ4, "chunk_size": 3000},
        {"compression": CompressionType.NONE, "chunk_size": 3000},
        {"use_chunking": False},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
        {
            "index_types": IndexType.NONE,
            "repeat_channels": False,
            "repeat_schemas": False,
            "use_statistics": False,
            "use_summary_offsets": False,
        },
    ],
    ids=lambda options: "-".join(options) or "plain",
)
def test_a_file_of_the_mcap_library_reads_as_that_library_reads_it(
    tmp_path: Path, rig_toml: str, options: dict[str, Any]
) -> None:
    path = tmp_path / "a.mcap"
    write_third_party(path, rig_toml, **options)
    recording = read_recording(path)
    expected: dict[str, list[Reading]] = {"q1": [], "q2": []}
    reader = NonSeekingReader(io.BytesIO(path.read_bytes()), decoder_factories=[DecoderFactory()])
    for found in reader.iter_decoded_messages(topics=["/channel/q1", "/channel/q2"]):
        name = found.channel.topic.rpartition("/")[2]
        message = found.decoded_message
        expected[name].append(
            Reading(
                name,
                found.message.log_time,
                message.raw,
                message.device_time_ns if message.HasField("device_time_ns") else None,
                message.sequence if message.HasField("sequence") else None,
                ReadingFlag(message.flags),
            )
        )
    assert len(expected["q1"]) == len(expected["q2"]) == 200
    for name, readings in expected.items():
        assert_holds(recording.readings[name], readings)
    assert recording.dwells == (Dwell(50_000, 0, 50_000, 0, 0),)
    assert recording.session == Session(software="")
    assert recording.rig_toml == rig_toml


def test_bytes_that_look_like_records_mislead_nobody(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    """Marks and counts full of what could be the beginning of a record."""
    path = tmp_path / "a.mcap"
    fake = b"\x05\x16\0\0\0\0\0\0\0".decode("latin-1")
    with Writer(path, rig_toml, session) as writer:
        for i in range(300):
            t = session.start_ns + i
            writer.write(Mark(t, fake * 20 + "x" * (i % 50)))
            writer.write(Reading("q1", t, 5, device_time_ns=0x16_05))
            writer.write(Reading("q2", t - t % 2**24, 0x05_00_00_05, sequence=5))
    recording = read_recording(path)
    assert len(recording.marks) == len(recording.readings["q1"]) == 300
    assert set(recording.readings["q2"].raw.tolist()) == {0x05_00_00_05}


def foreign(path: Path, profile: str, rig: bytes | None, topic: str = "/t", **kind: str) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile=profile, library="ros")
        if rig is not None:
            writer.add_attachment(0, 0, "rig.toml", "application/toml", rig)
        schema = writer.register_schema(kind.get("schema", "loopcal.Reading"), "protobuf", b"")
        channel = writer.register_channel(topic, kind.get("encoding", "protobuf"), schema)
        writer.add_message(channel, 1, messages_pb2.Reading(raw=1).SerializeToString(), 1)
        writer.finish()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path, rig: None, "there is no file '.*a.mcap'"),
        (lambda path, rig: path.mkdir(), "is not a file"),
        (lambda path, rig: path.write_bytes(b""), "is empty"),
        (lambda path, rig: path.write_bytes(b"\x89MCAP"), "is not an MCAP file"),
        (lambda path, rig: path.write_text("t,q1\n" * 99), "is not an MCAP file"),
        (
            lambda path, rig: foreign(path, "ros2", None),
            "profile 'ros2'.*expected profile 'loopcal'",
        ),
        (lambda path, rig: foreign(path, "loopcal", None), "carries no rig description"),
        (lambda path, rig: foreign(path, "loopcal", b"\xff"), "not UTF-8"),
        (
            lambda path, rig: foreign(path, "loopcal", rig, "/channel/q9"),
            "readings of 'q9', which its rig description does not name; channels: q1, q2",
        ),
        (
            lambda path, rig: foreign(path, "loopcal", rig, "/channel/q1", encoding="json"),
            "topic '/channel/q1' carries 'loopcal.Reading' as 'json'",
        ),
        (
            lambda path, rig: foreign(path, "loopcal", rig, "/channel/q1", schema="a.B"),
            "carries 'a.B'.*expected 'loopcal.Reading'",
        ),
    ],
)
def test_what_is_not_a_recording_is_told_so(
    tmp_path: Path, rig_toml: str, make: Any, message: str
) -> None:
    path = tmp_path / "a.mcap"
    make(path, rig_toml.encode())
    for damaged_ok in (False, True):
        with pytest.raises(NotARecording, match=message):
            read_recording(path, damaged_ok=damaged_ok)


def test_a_bad_rig_in_a_recording_is_told_as_such(tmp_path: Path) -> None:
    foreign(tmp_path / "a.mcap", "loopcal", b"schema = 2")
    with pytest.raises(RigError, match=r"rig description that '.*a\.mcap' carries"):
        read_recording(tmp_path / "a.mcap")


def test_a_reading_without_a_count_is_damage(tmp_path: Path, rig_toml: str) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="loopcal", library="someone else")
        writer.add_attachment(0, 0, "rig.toml", "application/toml", rig_toml.encode())
        schema = writer.register_schema("loopcal.Reading", "protobuf", descriptor_set())
        channel = writer.register_channel("/channel/q1", "protobuf", schema)
        for time_ns, payload in enumerate(
            (
                messages_pb2.Reading(raw=1).SerializeToString(),
                messages_pb2.Reading(sequence=1).SerializeToString(),
                b"\xff\xff",
                b"",
            )
        ):
            writer.add_message(channel, time_ns, payload, time_ns)
        writer.finish()
    with pytest.raises(DamagedRecording, match="3 readings that cannot be read, or have no 'raw'"):
        read_recording(path)
    assert read_recording(path, damaged_ok=True).readings["q1"].raw.tolist() == [1]
