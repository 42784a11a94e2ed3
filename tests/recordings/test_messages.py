"""The protobuf messages, and the two ways of writing a reading."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st

from recordings import codec, events, messages_pb2
from recordings.events import Event, Mode, SessionState
from recordings.wire import encode_reading, encode_rows

ROOT = Path(messages_pb2.__file__).parent.parent

INT64 = st.integers(-(2**63), 2**63 - 1)
UINT32 = st.integers(0, 2**32 - 1)


def test_regenerating_gives_the_committed_descriptor(tmp_path: Path) -> None:
    out = tmp_path / "set.bin"
    command = [sys.executable, "-m", "grpc_tools.protoc", "-I."]
    command += [f"--descriptor_set_out={out}", "recordings/messages.proto"]
    subprocess.run(command, cwd=ROOT, check=True, timeout=60)
    (described,) = FileDescriptorSet.FromString(out.read_bytes()).file
    committed = type(described).FromString(messages_pb2.DESCRIPTOR.serialized_pb)
    described.ClearField("source_code_info")
    for message in (*described.message_type, *committed.message_type):
        for field in message.field:
            field.ClearField("json_name")
    assert described == committed


def test_there_is_one_message_for_every_event() -> None:
    named = {kind.event.__name__: kind.message.DESCRIPTOR for kind in codec.KINDS}
    assert set(named) == set(messages_pb2.DESCRIPTOR.message_types_by_name)
    assert set(named) == {kind.__name__ for kind in Event.__args__}
    for kind in codec.KINDS:
        outside = {"time_ns", kind.subject}
        expected = [field.name for field in fields(kind.event) if field.name not in outside]
        assert [field.name for field in kind.message.DESCRIPTOR.fields] == expected


def test_the_modes_are_those_of_the_events() -> None:
    assert dict(messages_pb2.Mode.items()) == {mode.name: mode.value for mode in Mode}
    states = {state.name: state.value for state in SessionState}
    assert dict(messages_pb2.SessionState.items()) == {"NO_STATE": 0, **states}


def test_every_field_has_presence_and_numbers_have_fixed_width() -> None:
    for message in messages_pb2.DESCRIPTOR.message_types_by_name.values():
        for field in message.fields:
            assert field.has_presence, field.full_name
            varints = (field.TYPE_INT32, field.TYPE_INT64, field.TYPE_UINT32, field.TYPE_UINT64)
            zigzag = (field.TYPE_SINT32, field.TYPE_SINT64)
            assert field.type not in (*varints, *zigzag), field.full_name


@given(INT64, st.none() | INT64, st.none() | UINT32, UINT32)
def test_a_reading_is_written_as_protobuf_writes_it(
    raw: int, device_time_ns: int | None, sequence: int | None, flags: int
) -> None:
    message = messages_pb2.Reading(
        raw=raw, device_time_ns=device_time_ns, sequence=sequence, flags=flags
    )
    assert encode_reading(raw, device_time_ns, sequence, flags) == message.SerializeToString()


@pytest.mark.parametrize(
    "present", [(), ("device_time_ns",), ("sequence",), ("device_time_ns", "sequence")]
)
def test_rows_hold_what_single_readings_hold(present: tuple[str, ...]) -> None:
    rng = np.random.default_rng(3)
    columns = {
        "time_ns": rng.integers(0, 2**63 - 1, 50),
        "raw": rng.integers(-(2**63), 2**63 - 1, 50),
        "flags": rng.integers(0, 2**32, 50),
    }
    columns |= {name: rng.integers(0, 2**32, 50) for name in present}
    rows = encode_rows(258, 2**32 - 10, columns)
    for i, row in enumerate(rows):
        device_time_ns, sequence = (
            int(columns[name][i]) if name in columns else None
            for name in ("device_time_ns", "sequence")
        )
        payload = encode_reading(
            int(columns["raw"][i]), device_time_ns, sequence, int(columns["flags"][i])
        )
        time_ns = int(columns["time_ns"][i]).to_bytes(8, "little")
        head = b"\x05" + (22 + len(payload)).to_bytes(8, "little") + b"\x02\x01"
        counter = ((2**32 - 10 + i) % 2**32).to_bytes(4, "little")
        assert row.tobytes() == head + counter + time_ns + time_ns + payload


def test_events_come_back_from_their_bytes(one_of_each: tuple[Event, ...]) -> None:
    for event in one_of_each:
        kind = codec.kind_of(event)
        subject = "" if kind.subject is None else getattr(event, kind.subject)
        assert codec.kind_of_topic(kind.topic(subject)) == (kind, subject)
        assert codec.decode(kind, subject, event.time_ns, codec.encode(event)) == event


@pytest.mark.parametrize(
    "topic",
    ["/channel/", "/joint/base", "/joint//mode", "/joint/mode", "/session/other", "/tf", ""],
)
def test_other_topics_are_not_of_the_format(topic: str) -> None:
    assert codec.kind_of_topic(topic) is None


def test_what_is_not_a_message_is_told_so() -> None:
    dwell = codec.kind_of(events.Dwell(0, 0, 0, 0, 0))
    without_visit = messages_pb2.Dwell(start_ns=1, end_ns=2, pose=3).SerializeToString()
    with pytest.raises(ValueError, match="without 'visit'"):
        codec.decode(dwell, "", 0, without_visit)
    with pytest.raises(ValueError, match=r"not a loopcal\.Dwell message"):
        codec.decode(dwell, "", 0, b"\xff")
    report = codec.kind_of(events.ModeReport("base", 0, Mode.OFF, 0))
    with pytest.raises(ValueError, match="99 is not a valid Mode"):
        codec.decode(report, "base", 0, b"\x08\x63\x15\x00\x00\x00\x00")
