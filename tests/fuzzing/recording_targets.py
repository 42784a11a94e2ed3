"""Who reads recordings: the reader, survey and recovery of whole files, and payloads against protobuf."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from recordings import messages_pb2
from recordings.columns import decode_readings, messages
from recordings.errors import NotARecording, RecordingsError, RigError
from recordings.events import Dwell, Mark, Reading
from recordings.health import findings
from recordings.offsets import record_offsets
from recordings.reader import read_recording
from recordings.recording import Recording
from recordings.recover import recover
from recordings.session import Session
from recordings.storage import Storage
from recordings.survey import survey
from recordings.wire import encode_reading
from recordings.writer import Writer
from tests.fuzzing.target import Target

START_NS = 1_700_000_000_000_000_000
RIG = """\
schema = 1
name = "fuzz"
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "base"
[[channel]]
name = "q1"
senses = "base"
gain_deg_per_count = 0.01
"""


def _foreign(**options: Any) -> bytes:
    """By the mcap library, several chunks, or none."""
    file = io.BytesIO()
    described = FileDescriptorSet()
    messages_pb2.DESCRIPTOR.CopyToProto(described.file.add())
    writer = McapWriter(file, **options)
    writer.start(profile="loopcal", library="mcap")
    writer.add_attachment(0, 0, "rig.toml", "application/toml", RIG.encode())
    writer.add_metadata("loopcal.session", {"session_id": "x", "start_time_ns": "5"})
    schema = writer.register_schema("loopcal.Reading", "protobuf", described.SerializeToString())
    topic = writer.register_channel("/channel/q1", "protobuf", schema)
    for i in range(60):
        writer.add_message(topic, i, encode_reading(i, i * 7, i, 0), i)
    writer.finish()
    return file.getvalue()


@cache
def _files() -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        with Writer(path, RIG, Session("fuzz", START_NS)) as writer:
            for i in range(90):
                writer.write(Reading("q1", START_NS + i, i, i, i))
                if i % 30 == 29:
                    writer.write(Dwell(START_NS + i, START_NS, START_NS + i, 0, 0))
                    writer.write(Mark(START_NS + i, "here"))
                    writer.flush()
        own = path.read_bytes()
        part = Path(folder) / "b.mcap"
        with Writer(part, RIG, Session("fuzz", START_NS), Storage(rotate_bytes=9000)) as writer:
            while len(writer.paths) == 1:
                writer.write(Reading("q1", START_NS, 7))
                writer.flush()
        first = part.read_bytes()
    free = {"enable_crcs": False, "chunk_size": 700}
    return (
        own,
        first,
        _foreign(compression=CompressionType.NONE, **free),
        _foreign(compression=CompressionType.LZ4, **free),
        _foreign(compression=CompressionType.ZSTD, **free),
        _foreign(use_chunking=False, enable_crcs=False),
    )


def _read(data: bytes, *, damaged_ok: bool) -> Recording:
    with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
        Path(file.name).write_bytes(data)
        return read_recording(file.name, damaged_ok=damaged_ok)


def _check_file(data: bytes) -> None:
    with suppress(RecordingsError):
        recording = _read(data, damaged_ok=True)
        for readings in recording.readings.values():
            columns = (readings.time_ns, readings.raw, readings.flags)
            assert len({len(column) for column in columns}) == 1
            assert not np.any(np.diff(readings.time_ns.astype(object)) < 0)
            assert len(readings) <= len(data) * 2000, "more readings than any compression holds"
        if not recording.damage:
            assert _same(_read(data, damaged_ok=False), recording)


def _check_survey(data: bytes) -> None:
    """A survey counts what the reader reads, and what is thought of it can be said."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        path.write_bytes(data)
        with suppress(RecordingsError):
            found = survey(path)
            for finding in findings(found):
                assert finding.text
            readings = read_recording(path, damaged_ok=True).readings
            for name, counted in found.readings.items():
                assert found.channel(name).count - counted.unreadable == len(readings[name])


def _check_recovery(data: bytes) -> None:
    """What is recovered of a file is a whole recording of all that the reader reads of it, or none."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "a.mcap", Path(folder) / "saved.mcap"
        source.write_bytes(data)
        try:
            recover(source, target)
        except RecordingsError:
            assert list(Path(folder).iterdir()) == [source]
            return
        finally:
            assert source.read_bytes() == data, "it touched its input"
        with suppress(RigError, NotARecording):
            assert _same(read_recording(target), read_recording(source, damaged_ok=True))


def _check_recovery_flips(data: bytes, other: bytes) -> None:
    """Of a file with all its CRCs, nothing is saved that was not written."""
    if data is not _files()[0] or other == data:
        return
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "a.mcap", Path(folder) / "saved.mcap"
        source.write_bytes(other)
        with suppress(RecordingsError):
            recover(source, target)
            saved = read_recording(target)
            assert saved.rig_toml == RIG
            assert set(saved.readings["q1"].raw.tolist()) <= set(range(90))
            assert set(saved.dwells) <= set(_whole().dwells)


def _check_flips(data: bytes, other: bytes) -> None:
    """A file with all its CRCs: what is read without a word is what was written."""
    if data is not _files()[0] or other == data:
        return
    with suppress(RecordingsError):
        assert _same(_read(other, damaged_ok=False), _whole()), "a change passed for the truth"
    # What is left of a damaged file is part of what was written.
    with suppress(RecordingsError):
        left = _read(other, damaged_ok=True).readings["q1"]
        assert set(left.raw.tolist()) <= set(range(90))


@cache
def _whole() -> Recording:
    return _read(_files()[0], damaged_ok=False)


def _same(one: Recording, other: Recording) -> bool:
    a, b = one.readings["q1"], other.readings["q1"]
    return (
        np.array_equal(a.time_ns, b.time_ns)
        and np.array_equal(a.raw, b.raw)
        and one.dwells == other.dwells
        and one.rig_toml == other.rig_toml
    )


def _record(content: bytes) -> bytes:
    return b"\x05" + len(content).to_bytes(8, "little") + content


def _payload_seeds() -> Sequence[bytes]:
    return [
        encode_reading(5, 6, 7, 1) + encode_reading(-5, None, None, 0),
        encode_reading(2**62, -1, None, 7) * 3,
        messages_pb2.Reading(raw=3).SerializeToString(),
        b"\x7a\x03new" + encode_reading(1, None, 2**32 - 1, 0),
    ]


def _check_payloads(data: bytes) -> None:
    """Any bytes as payloads of several lengths: what arrays say is what protobuf says."""
    sizes = (28, 14, 19, 23, 9, 18, len(data))
    payloads = [data[at : at + size] for size in sizes for at in range(0, len(data), 17)][:40]
    block = b"".join(_record(bytes(22) + payload) for payload in payloads)
    found = messages(block, record_offsets(block)[0])
    columns, unreadable = decode_readings(found)
    rows = []
    for payload in payloads:
        message = messages_pb2.Reading()
        with suppress(DecodeError):
            message.ParseFromString(payload)
            if message.HasField("raw"):
                rows.append(message)
    assert unreadable == len(payloads) - len(rows)
    assert columns.raw.tolist() == [row.raw for row in rows]
    assert columns.flags.tolist() == [row.flags for row in rows]
    for name in ("device_time_ns", "sequence"):
        values = getattr(columns, name)
        if not all(row.HasField(name) for row in rows):
            assert values is None
        elif rows:
            assert values.tolist() == [getattr(row, name) for row in rows]


TOKENS = (
    b"\x89MCAP0\r\n",
    *(bytes([opcode]) for opcode in (1, 2, 3, 4, 5, 6, 7, 9, 12, 15, 128)),
    b"\x04\0\0\0zstd",
    b"\x03\0\0\0lz4",
    b"/channel/q1",
    b"/session/dwell",
    b"/ledger/q1",
    b"loopcal.next",
    b"loopcal.part",
    b"loopcal.recovery",
)
TARGETS = (
    Target("recording", _files, _check_file, tokens=TOKENS, check_flips=_check_flips),
    Target("survey", _files, _check_survey, tokens=TOKENS),
    Target("recovery", _files, _check_recovery, tokens=TOKENS, check_flips=_check_recovery_flips),
    Target(
        "readings", _payload_seeds, _check_payloads, tokens=(b"\x09", b"\x11", b"\x1d", b"\x25")
    ),
)
