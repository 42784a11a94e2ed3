"""What the writer puts into a file, as the mcap library and protobuf see it."""

from __future__ import annotations

import errno
import io
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.message import Message
from mcap.data_stream import ReadDataStream
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, MessageIndex
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap_protobuf.decoder import DecoderFactory

from recordings import codec
from recordings.errors import DiskFailed, RecordingError, RigError
from recordings.events import (
    Dwell,
    Event,
    LedgerEntry,
    Mark,
    Mode,
    ModeCommand,
    Reading,
    ReadingFlag,
)
from recordings.open_chunk import CHUNK_BYTES
from recordings.reader import read_recording
from recordings.session import Session
from recordings.storage import RecordingFile
from recordings.writer import Writer

START_NS = 1_700_000_000_000_000_000


def decoded(path: Path) -> list[tuple[str, int, Message]]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [
            (found.channel.topic, found.message.log_time, found.decoded_message)
            for found in reader.iter_decoded_messages(log_time_order=False)
        ]


def test_mcap_decodes_every_topic(
    tmp_path: Path, rig_toml: str, session: Session, one_of_each: tuple[Event, ...]
) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        for event in one_of_each:
            writer.write(event)
    found = decoded(path)
    for event, (topic, time_ns, message) in zip(one_of_each, found, strict=False):
        kind = codec.kind_of(event)
        assert message.DESCRIPTOR.full_name == f"loopcal.{type(event).__name__}"
        assert topic == kind.topic("" if kind.subject is None else getattr(event, kind.subject))
        assert time_ns == event.time_ns
        for field in message.DESCRIPTOR.fields:
            value = getattr(event, field.name)
            assert message.HasField(field.name) == (value is not None)
            if value is not None:
                assert getattr(message, field.name) == value
    ledger = [topic for topic, _, _ in found[len(one_of_each) :]]
    assert ledger == ["/ledger/q1", "/ledger/q2"]


def test_summary_index_and_statistics_are_those_of_the_data(
    tmp_path: Path, write_session: Callable[..., Path]
) -> None:
    path = write_session(tmp_path / "a.mcap", seconds=30)
    data = path.read_bytes()
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    header, summary = reader.get_header(), reader.get_summary()
    assert header.profile == "loopcal"
    assert header.library == "loopcal 0.1.0"
    assert summary is not None
    assert summary.statistics is not None
    counts: Counter[int] = Counter()
    times = []
    counters: dict[int, int] = {}
    for _, channel, message in reader.iter_messages(log_time_order=False):
        assert message.sequence == counters.get(channel.id, 0)
        assert message.publish_time == message.log_time
        counters[channel.id] = message.sequence + 1
        counts[channel.id] += 1
        times.append(message.log_time)
    statistics = summary.statistics
    assert statistics.channel_message_counts == dict(counts)
    assert statistics.message_count == len(times) == 2 * 3000 + 30 + 2 * 31
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    assert statistics.chunk_count == len(summary.chunk_indexes) == 31
    assert (statistics.attachment_count, statistics.metadata_count) == (3, 3)
    assert statistics.channel_count == len(summary.channels) == 5
    assert statistics.schema_count == len(summary.schemas) == 3
    # The streaming reader checks the CRC of the whole data section too.
    streamed = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    assert sum(1 for _ in streamed.iter_messages()) == len(times)
    for topic in ("/channel/q1", "/session/dwell"):  # by the message index
        assert all(channel.topic == topic for _, channel, _ in reader.iter_messages(topics=topic))


def test_message_index_points_at_its_messages(
    tmp_path: Path, write_session: Callable[..., Path]
) -> None:
    data = write_session(tmp_path / "a.mcap").read_bytes()
    chunk_data = b""
    checked = 0
    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(record, Chunk):
            stream, size = get_chunk_data_stream(record)
            chunk_data = stream.read(size)
        elif isinstance(record, MessageIndex):
            for log_time, offset in record.records:
                length = int.from_bytes(chunk_data[offset + 1 : offset + 9], "little")
                found = McapMessage.read(
                    ReadDataStream(io.BytesIO(chunk_data[offset + 9 :])), length
                )
                assert (found.channel_id, found.log_time) == (record.channel_id, log_time)
                checked += 1
    assert checked == 2 * 300 + 3 + 2 * 4


def test_rig_and_session_are_attached_as_they_are(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    text = rig_toml.replace("\n", "\r\n")
    with Writer(tmp_path / "a.mcap", text, session):
        pass
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        attachments = list(reader.iter_attachments())
        metadata, copy = reader.iter_metadata()
    assert [(each.name, each.data) for each in attachments] == 2 * [("rig.toml", text.encode())]
    assert metadata == copy
    assert metadata.name == "loopcal.session"
    assert metadata.metadata == {
        "session_id": "2023-11-14-a",
        "start_time_ns": "1700000000000000000",
        "start_utc": "2023-11-14T22:13:20.000000000Z",
        "operator": "Ada",
        "notes": "first\nsecond",
        "host": "bench-pc",
        "software": "loopcal 9",
    }


def test_arrays_give_the_same_bytes_as_single_readings(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    count = 5000
    rng = np.random.default_rng(1)
    time_ns = START_NS + np.cumsum(rng.integers(1, 10**7, count))
    raw = rng.integers(-(2**40), 2**40, count)
    device = rng.integers(0, 2**62, count)
    sequence = np.arange(count, dtype=np.uint32)
    flags = rng.integers(0, 8, count)
    with Writer(tmp_path / "many.mcap", rig_toml, session) as writer:
        writer.write_readings(
            "q1", time_ns[:1234], raw[:1234], device[:1234], sequence[:1234], flags[:1234]
        )
        writer.write_readings("q1", [], [])
        writer.write_readings(
            "q1", time_ns[1234:], raw[1234:], device[1234:], sequence[1234:], flags[1234:]
        )
    with Writer(tmp_path / "one.mcap", rig_toml, session) as writer:
        for i in range(count):
            writer.write(
                Reading(
                    "q1",
                    int(time_ns[i]),
                    int(raw[i]),
                    int(device[i]),
                    int(sequence[i]),
                    ReadingFlag(int(flags[i])),
                )
            )
    assert (tmp_path / "many.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()


def test_chunks_are_small(tmp_path: Path, rig_toml: str, session: Session) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        writer.write_readings("q1", START_NS + np.arange(60_000), np.arange(60_000))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    assert len(sizes) > 10
    assert max(sizes) < CHUNK_BYTES + 100
    assert min(sizes[:-1]) >= CHUNK_BYTES
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}


def test_bulk_writing_is_fast_enough_for_simulation(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    time_ns = START_NS + np.arange(28_000) * 10_000_000
    best = float("inf")
    for attempt in range(3):
        start = time.process_time()
        with Writer(tmp_path / f"{attempt}.mcap", rig_toml, session) as writer:
            for channel in ("q1", "q2"):
                writer.write_readings(channel, time_ns, time_ns % 4096, time_ns // 7)
        best = min(best, time.process_time() - start)
    assert best < 0.3


def test_what_is_flushed_is_in_the_file(tmp_path: Path, rig_toml: str, session: Session) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        writer.write(Reading("q1", START_NS, 1))
        writer.flush(START_NS + 5)
        writer.write(Mark(START_NS + 6, "still in memory"))
        before = read_recording(path, damaged_ok=True)
    assert before.readings["q1"].raw.tolist() == [1]
    assert before.ledger["q1"].time_ns == START_NS + 5
    assert before.marks == ()
    assert "never closed" in before.damage[-1]
    assert read_recording(path).marks == (Mark(START_NS + 6, "still in memory"),)


def test_an_existing_file_is_never_replaced(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError, match=r"a\.mcap' exists already.*another name"):
        Writer(path, rig_toml, session)
    assert path.read_bytes() == b"precious"


def test_a_bad_rig_leaves_no_file(tmp_path: Path, session: Session) -> None:
    with pytest.raises(RigError):
        Writer(tmp_path / "a.mcap", "schema = 1", session)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_told(tmp_path: Path, rig_toml: str, session: Session) -> None:
    with pytest.raises(RecordingError, match="cannot create the recording"):
        Writer(tmp_path / "no" / "a.mcap", rig_toml, session)


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (Reading("q9", START_NS, 1), "'q9' is not a channel of the rig; channels: q1, q2"),
        (
            ModeCommand("knee", START_NS, Mode.FREE, None, ""),
            "'knee' is not a joint of the rig; joints: base, elbow, slide",
        ),
        (Reading("q1", START_NS, 2**63), "cannot record Reading"),
        (Reading("q1", START_NS, 1, sequence=-1), "cannot record Reading"),
        (Reading("q1", -1, 1), "cannot record Reading"),
        (Dwell(START_NS, 0, 0, 2**31, 0), "cannot record Dwell"),
    ],
)
def test_an_event_that_does_not_fit_is_refused_and_the_rest_is_kept(
    tmp_path: Path, rig_toml: str, session: Session, event: Event, message: str
) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        writer.write(Reading("q1", START_NS, 1))
        with pytest.raises(RecordingError, match=message):
            writer.write(event)
        writer.write(Reading("q1", START_NS + 1, 2))
    recording = read_recording(path)
    assert recording.readings["q1"].raw.tolist() == [1, 2]
    assert recording.ledger["q1"].received == 2


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        (([1, 2], [1]), ValueError, "differ in length"),
        (([1.0], [1]), ValueError, "row of integers"),
        (([[1]], [[1]]), ValueError, "row of integers"),
        (([-1], [1]), RecordingError, "'time_ns' has values outside"),
        (([1], [1], None, [2**32]), RecordingError, "'sequence' has values outside"),
        (([1], np.array([2**63], np.uint64)), RecordingError, "'raw' has values outside"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    tmp_path: Path,
    rig_toml: str,
    session: Session,
    columns: tuple[list[int], ...],
    error: type[Exception],
    message: str,
) -> None:
    with Writer(tmp_path / "a.mcap", rig_toml, session) as writer:
        with pytest.raises(error, match=message):
            writer.write_readings("q1", *columns)
        with pytest.raises(RecordingError, match="not a channel of the rig"):
            writer.write_readings("q9", [1], [1])
    assert len(read_recording(tmp_path / "a.mcap").readings["q1"]) == 0


def test_a_closed_recording_takes_nothing(tmp_path: Path, rig_toml: str, session: Session) -> None:
    writer = Writer(tmp_path / "a.mcap", rig_toml, session)
    writer.close()
    writer.close()
    for act in (
        lambda: writer.write(Mark(START_NS, "late")),
        lambda: writer.write_readings("q1", [START_NS], [1]),
        lambda: writer.flush(START_NS),
    ):
        with pytest.raises(RecordingError, match="is closed"):
            act()


def test_a_failing_disk_ends_the_recording_and_keeps_what_was_flushed(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    writer = Writer(path, rig_toml, session)
    writer.write(Reading("q1", START_NS, 1))
    writer.flush(START_NS)

    def fail(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    writer.write(Reading("q1", START_NS + 1, 2))
    monkeypatch.setattr(RecordingFile, "write", fail)
    with pytest.raises(DiskFailed, match=r"disk failed: Input/output.*written before") as caught:
        writer.flush(START_NS + 1)
    assert caught.value.lost == {"q1": 1}
    with pytest.raises(RecordingError, match="is closed"):
        writer.write(Reading("q1", START_NS + 2, 3))
    writer.close()
    assert read_recording(path, damaged_ok=True).readings["q1"].raw.tolist() == [1]


def test_ledger_counts_what_came_and_takes_what_was_lost(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        for i in range(10):
            writer.write(Reading("q1", START_NS + i, i))
        writer.write_readings("q2", START_NS + np.arange(5), np.arange(5))
        writer.account(
            "q1", expected=20, dropped_by_device=1, dropped_by_host=2, lost_in_gaps=4, gaps=1
        )
        writer.flush(START_NS + 100)
        first = writer.ledger(START_NS + 100)
        writer.account(
            "q1", expected=21, dropped_by_device=1, dropped_by_host=4, lost_in_gaps=6, gaps=2
        )
        with pytest.raises(RecordingError, match="'bus' is not a channel"):
            writer.account("bus", expected=1)
    assert first == (
        LedgerEntry("q1", START_NS + 100, 20, 10, 1, 2, 4, 1),
        LedgerEntry("q2", START_NS + 100, 5, 5, 0, 0, 0, 0),
    )
    assert [entry.unaccounted for entry in first] == [3, 0]
    recording = read_recording(path)
    assert recording.ledger["q1"] == LedgerEntry("q1", START_NS + 100, 21, 10, 1, 4, 6, 2)
    assert recording.ledger["q1"].unaccounted == 0
    written = [(topic, at) for topic, at, _ in decoded(path) if topic.startswith("/ledger/")]
    assert written == [
        ("/ledger/q1", START_NS + 100),
        ("/ledger/q2", START_NS + 100),
        ("/ledger/q1", START_NS + 100),
        ("/ledger/q2", START_NS + 100),
    ]


def test_a_ledger_kept_by_the_caller_stays_the_callers(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    path = tmp_path / "a.mcap"
    entry = LedgerEntry("q1", START_NS + 1, 9, 1, 8, 0, 0, 0)
    with Writer(path, rig_toml, session) as writer:
        writer.write(Reading("q1", START_NS, 1))
        writer.write(entry)
    assert read_recording(path).ledger["q1"] == entry


def test_the_same_events_give_the_same_bytes(
    tmp_path: Path, write_session: Callable[..., Path]
) -> None:
    first = write_session(tmp_path / "a.mcap")
    assert first.read_bytes() == write_session(tmp_path / "b.mcap").read_bytes()
