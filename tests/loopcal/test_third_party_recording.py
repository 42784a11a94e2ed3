"""A recording written with the mcap library and protobuf alone solves to the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer as ThirdPartyWriter

from recordings.reader import read_recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.result import result
from solver.solve import solve


def reading_schema() -> tuple[type, bytes]:
    """The Reading message and its FileDescriptorSet, made from the text of docs/formats.md alone."""
    file = descriptor_pb2.FileDescriptorProto(name="mine.proto", package="loopcal", syntax="proto3")
    message = file.message_type.add(name="Reading")
    field = message.field.add(name="raw", number=1)
    field.type = descriptor_pb2.FieldDescriptorProto.TYPE_SFIXED64
    field.label = descriptor_pb2.FieldDescriptorProto.LABEL_OPTIONAL
    field.proto3_optional = True
    field.oneof_index = 0
    message.oneof_decl.add(name="_raw")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("loopcal.Reading"))
    return kind, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def test_a_recording_made_without_this_projects_writer_solves_alike(tmp_path: Path) -> None:
    simulate(load_rig("shoulder"), rig_text("shoulder")[0], tmp_path / "ours.mcap", seed=5)
    ours = read_recording(tmp_path / "ours.mcap")

    kind, schema = reading_schema()
    with (tmp_path / "theirs.mcap").open("wb") as stream:
        writer = ThirdPartyWriter(stream)
        writer.start(profile="loopcal", library="somebody else's")
        writer.add_attachment(0, 0, "rig.toml", "application/toml", ours.rig_toml.encode())
        schema_id = writer.register_schema("loopcal.Reading", "protobuf", schema)
        messages = []
        for name, readings in ours.readings.items():
            channel = writer.register_channel(f"/channel/{name}", "protobuf", schema_id)
            for time_ns, raw in zip(readings.time_ns.tolist(), readings.raw.tolist(), strict=True):
                messages.append((time_ns, channel, kind(raw=raw).SerializeToString()))
        for time_ns, channel, payload in sorted(messages):
            writer.add_message(channel, time_ns, payload, time_ns)
        writer.finish()

    mine, theirs = (
        result(solve(read_recording(tmp_path / f"{n}.mcap"))) for n in ("ours", "theirs")
    )
    for a, b in zip(mine["parameters"], theirs["parameters"], strict=True):
        assert a["name"] == b["name"]
        np.testing.assert_allclose(a["value"], b["value"], rtol=1e-12)
    assert mine["poses"] == theirs["poses"]
