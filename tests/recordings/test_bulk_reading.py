"""Reading by arrays gives what the mcap library gives message by message, however a file is written."""

from __future__ import annotations

import io
import tempfile
import tracemalloc
import zlib
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

from recordings import chunks, messages_pb2
from recordings.errors import DamagedRecording
from recordings.offsets import leading_bytes
from recordings.reader import Readings, read_recording
from recordings.stream import PIECE_BYTES, Stream

TIME = st.integers(0, 50) | st.integers(0, 2**63 - 1)
INT64 = st.integers(-(2**63), 2**63 - 1)
UINT32 = st.integers(0, 2**32 - 1)
# Numbers whose bytes are heads of records, which might mislead who looks for them.
SLY = st.sampled_from([5, 0x16_05, 0x3B05 << 16, 5 << 32 | 4, 0x0500_0000_0000_0025])


def field(tag: int, size: int, value: int) -> bytes:
    return bytes([tag]) + (value % 2 ** (8 * size)).to_bytes(size, "little")


@st.composite
def payloads(draw: st.DrawFn) -> bytes:
    """A reading as some program may write it, the fields in any order, some of them twice or unknown."""
    parts = [field(0x09, 8, draw(INT64 | SLY))]
    if draw(st.booleans()):
        parts.append(field(0x11, 8, draw(INT64 | SLY)))
    if draw(st.booleans()):
        parts.append(field(0x1D, 4, draw(UINT32)))
    if draw(st.booleans()):
        parts.append(field(0x25, 4, draw(st.integers(0, 7))))
    odd = draw(st.sampled_from(["plain"] * 6 + ["shuffled", "twice", "unknown", "text"]))
    if odd == "shuffled":
        parts = draw(st.permutations(parts))
    elif odd == "twice":
        parts.append(field(0x09, 8, draw(INT64)))
    elif odd == "unknown":
        parts.insert(draw(st.integers(0, len(parts))), b"\x7a\x03new")
    elif odd == "text":
        parts.append(b"\x7a\x0b" + field(0x05, 8, 22) + b"\0\0")
    return b"".join(parts)


@st.composite
def runs(draw: st.DrawFn) -> list[tuple[str, int, bytes]]:
    """Topic, time and payload: one after the other, or many alike in turns."""
    topics = st.sampled_from(["/channel/q1", "/channel/q2", "/session/mark", "/camera"])
    out: list[tuple[str, int, bytes]] = []
    for _ in range(draw(st.integers(0, 8))):
        topic, time_ns, payload = draw(topics), draw(TIME), draw(payloads())
        repeated = draw(st.sampled_from([1, 1, 2, 40]))
        for k in range(repeated):
            other = "/channel/q2" if topic == "/channel/q1" and k % 2 else topic
            if topic == "/session/mark":
                payload = messages_pb2.Mark(text="\x05\x16" + "\0" * k).SerializeToString()
            out.append((other, min(time_ns + k, 2**63 - 1), payload))
    return out


OPTIONS = st.fixed_dictionaries(
    {
        "chunk_size": st.sampled_from([1, 200, 5000, 1 << 20]),
        "compression": st.sampled_from(CompressionType),
        "use_chunking": st.booleans(),
        "enable_crcs": st.booleans(),
        "enable_data_crcs": st.booleans(),
        "repeat_channels": st.booleans(),
        "index_types": st.sampled_from([IndexType.ALL, IndexType.NONE]),
    }
)


def write(path: Path, rig_toml: str, found: list[tuple[str, int, bytes]], options: Any) -> None:
    described = FileDescriptorSet()
    messages_pb2.DESCRIPTOR.CopyToProto(described.file.add())
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="loopcal", library="someone else")
        other = writer.register_schema("other.Thing", "jsonschema", b"{}")
        reading, mark = (
            writer.register_schema(f"loopcal.{name}", "protobuf", described.SerializeToString())
            for name in ("Reading", "Mark")
        )
        schemas = {"/session/mark": mark, "/camera": other}
        ids: dict[str, int] = {}
        for topic, time_ns, payload in found:
            if topic not in ids:
                kind = "json" if topic == "/camera" else "protobuf"
                ids[topic] = writer.register_channel(topic, kind, schemas.get(topic, reading))
            writer.add_message(ids[topic], time_ns, payload, time_ns)
        writer.add_attachment(0, 0, "rig.toml", "application/toml", rig_toml.encode())
        writer.finish()


def by_the_library(path: Path, topic: str) -> list[tuple[int, int, int | None, int | None, int]]:
    """Time, counts, device time, sequence and flags, sorted by time as the format says."""
    reader = NonSeekingReader(io.BytesIO(path.read_bytes()), decoder_factories=[DecoderFactory()])
    rows = []
    for found in reader.iter_decoded_messages([topic], log_time_order=False):
        m = found.decoded_message
        device = m.device_time_ns if m.HasField("device_time_ns") else None
        sequence = m.sequence if m.HasField("sequence") else None
        rows.append((found.message.log_time, m.raw, device, sequence, m.flags))
    return sorted(rows, key=lambda row: row[0])


def rows_of(found: Readings) -> list[tuple[int, ...]]:
    columns = (found.time_ns, found.raw, found.device_time_ns, found.sequence, found.flags)
    none = [None] * len(found)
    lists = [none if column is None else column.tolist() for column in columns]
    return list(zip(*lists, strict=True))


@given(runs(), OPTIONS)
@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    deadline=None,
    derandomize=True,
    max_examples=150,
)
def test_any_file_reads_as_the_mcap_library_reads_it(
    rig_toml: str, found: list[tuple[str, int, bytes]], options: Any
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        write(path, rig_toml, found, options)
        recording = read_recording(path)
        for name, readings in recording.readings.items():
            expected = by_the_library(path, f"/channel/{name}")
            for place in (2, 3):  # a column that any reading lacks is None as a whole
                if any(row[place] is None for row in expected):
                    expected = [(*row[:place], None, *row[place + 1 :]) for row in expected]
            assert rows_of(readings) == expected
        assert len(recording.marks) == sum(topic == "/session/mark" for topic, _, _ in found)


def test_a_large_chunk_is_read_in_parts(
    tmp_path: Path, rig_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [("/channel/q1", i, field(0x09, 8, i * i)) for i in range(2000)]
    found.insert(700, ("/channel/q1", 700, field(0x09, 8, 5) + b"\x7a\x7f" + bytes(127)))
    path = tmp_path / "a.mcap"
    write(path, rig_toml, found, {"chunk_size": 1 << 20})
    whole = read_recording(path)
    for size in (50, 100, 300, 5000):
        monkeypatch.setattr(chunks, "LARGEST_BLOCK", size)
        assert rows_of(read_recording(path).readings["q1"]) == rows_of(whole.readings["q1"])
    assert len(whole.readings["q1"]) == 2001


def test_a_small_file_that_unpacks_to_much_is_refused_before_it_does(
    tmp_path: Path, rig_toml: str
) -> None:
    path = tmp_path / "a.mcap"
    write(path, rig_toml, [("/camera", 1, bytes(50_000_000))], {"chunk_size": 1 << 20})
    assert path.stat().st_size < 50_000
    tracemalloc.start()
    with pytest.raises(DamagedRecording, match=r"nothing recorded is so alike"):
        read_recording(path)
    assert tracemalloc.get_traced_memory()[1] < 20_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("chunked", [True, False])
def test_a_long_file_of_mixed_layouts_is_the_same_across_windows(
    tmp_path: Path, rig_toml: str, chunked: bool
) -> None:
    """Larger than what is decoded at a time, times disordered, both channels of several layouts."""
    rng = np.random.default_rng(3)
    found = []
    for i in range(30_000):
        parts = [field(0x09, 8, int(rng.integers(-(2**40), 2**40)))]
        parts += [field(0x11, 8, i)] if i // 5000 % 2 else []
        parts += [field(0x25, 4, 1)] if rng.random() < 0.3 else []
        found.append((f"/channel/q{1 + i % 2}", i + int(rng.integers(0, 5)), b"".join(parts)))
    path = tmp_path / "a.mcap"
    write(path, rig_toml, found, {"use_chunking": chunked, "chunk_size": 64 * 1024})
    for name, readings in read_recording(path).readings.items():
        expected = by_the_library(path, f"/channel/{name}")
        assert readings.time_ns.tolist() == [row[0] for row in expected]
        assert readings.raw.tolist() == [row[1] for row in expected]
        assert readings.flags.tolist() == [row[4] for row in expected]
        assert readings.device_time_ns is None


def record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + len(content).to_bytes(8, "little") + content


@given(
    st.lists(st.builds(record, st.sampled_from([3, 4, 5, 5, 5, 9]), st.binary(max_size=20))),
    st.binary(max_size=30),
)
def test_leading_records_of_a_block_are_whole(records: list[bytes], rest: bytes) -> None:
    data = b"".join(records) + rest
    ends = {0}
    for one in records:
        if one[0] == 9:
            break
        ends.add(max(ends) + len(one))
    size = leading_bytes(data)
    if size <= sum(map(len, records)):
        assert size in ends
    # However many there are, walking on from there always comes forward.
    assert (size == 0) == (len(ends) == 1) or not records


def test_a_stream_is_its_file_with_its_crc() -> None:
    data = np.random.default_rng(1).bytes(3 * PIECE_BYTES + 17)
    stream = Stream(io.BytesIO(data), 8, zlib.crc32(data[:8]))
    rng = np.random.default_rng(2)
    taken = data[:8]
    while len(taken) < len(data):
        size = int(rng.choice([0, 1, 9, 500, PIECE_BYTES - 1, PIECE_BYTES, 2 * PIECE_BYTES]))
        assert stream.at == len(taken)
        ahead = stream.peek(size)
        if rng.random() < 0.3:
            stream.pass_over(size)
            taken += ahead
        else:
            piece = stream.take(size)
            assert piece == ahead
            taken += piece
        if rng.random() < 0.5:
            assert stream.crc == zlib.crc32(taken)
    assert taken == data
    assert stream.crc == zlib.crc32(data)
    assert stream.take(5) == b""
    stream.go_to(10)
    assert (stream.at, stream.take(3), stream.crc) == (10, data[10:13], None)
