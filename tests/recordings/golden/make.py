"""Writes the golden recordings of a version: python tests/recordings/golden/make.py VERSION

Each is small, and has a JSON file beside it that says what is in it: what was handed to the
writer, not what a reader made of it. A version that is there already is never written again;
today's files must be readable for ever.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from recordings import messages_pb2
from recordings.codec import READING, schema_data
from recordings.events import (
    ClockSample,
    Dwell,
    Event,
    Fault,
    LedgerEntry,
    Mark,
    Mode,
    ModeCommand,
    ModeReport,
    Reading,
    ReadingFlag,
)
from recordings.session import Session
from recordings.writer import Writer

START_NS = 1_750_000_000_000_000_000
STEP_NS = 10_000_000
FLUSH = 6  # readings of each channel between two flushes
COUNT = 60
SESSION = Session("golden", START_NS, "Ada", "first\nsecond", "bench-pc", "loopcal golden")

RIG = """\
schema = 1
name = "golden"  # Prüfstand

[mechanism]
family = "serial"

[[mechanism.joint]]
name = "base"
a_m = 0.3

[[mechanism.joint]]
name = "elbow"
a_mm = { nominal = 250, uncertainty = 1, identify = true }

[[channel]]
name = "q1"
senses = "base"
gain_deg_per_count = 0.01

[[channel]]
name = "q2"
senses = "elbow"
gain_deg_per_count = 0.02
"""


def events() -> list[Event]:
    """Two channels at 100 Hz for 0.6 s, and one of everything else."""
    t = START_NS
    out: list[Event] = [
        ModeCommand("base", t, Mode.POSITION, -5, "pose 1"),
        ModeCommand("elbow", t, Mode.FREE, None, ""),
        ModeReport("base", t, Mode.FAULT, 0x1208, 0x8611),
        Mark(t, "a remark — with a dash"),
        Fault(t, "can0", "unplugged", "The adapter is gone."),
        ClockSample("encoder1", t, 123, t - 123, 1000),
    ]
    for i in range(COUNT):
        at = t + i * STEP_NS
        flag = ReadingFlag.OVERRANGE if i == 7 else ReadingFlag.NONE
        out.append(
            Reading("q1", at, (-1) ** i * (2**40 + i), 500 + i, (2**32 - 5 + i) % 2**32, flag)
        )
        out.append(Reading("q2", at + 1, 1000 - i))
        if i % 15 == 14:
            out.append(Dwell(at + 2, at - 9 * STEP_NS, at, i // 15, i % 2, None))
    out.append(LedgerEntry("q1", t + COUNT * STEP_NS, COUNT + 6, COUNT, 1, 2, 3, 1))
    return out


def main(folder: Path) -> None:
    """Write all files of one version to ``folder``, which is made."""
    folder.mkdir()
    write_whole(folder / "whole.mcap")
    write_damaged(folder / "damaged.mcap")
    write_foreign(folder / "foreign.mcap")
    write_parts(folder / "parts.mcap")


def write_whole(path: Path) -> None:
    """Closed, with one of each event."""
    with Writer(path, RIG, SESSION) as writer:
        _write(writer, events())
    expect(path, events())


def write_damaged(path: Path) -> None:
    """Cut off in its eighth chunk, with a wrong bit in its third."""
    write_whole(path)
    data = bytearray(path.read_bytes())
    chunks, at = [], 8
    while data[at] != 15:
        if data[at] == 6:
            chunks.append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[chunks[2] + 80] ^= 0x20
    path.write_bytes(data[: chunks[7] + 40])
    lost, cut = range(2 * FLUSH, 3 * FLUSH), 7 * FLUSH
    kept = [
        event
        for event in events()
        if (i := (event.time_ns - START_NS) // STEP_NS) < cut and i not in lost
    ]
    expect(path, kept, whole=False, missing=FLUSH)


def write_foreign(path: Path) -> None:
    """By the mcap library: LZ4, large chunks, another order of fields, topics of its own."""
    found = [e for e in events() if isinstance(e, Reading | Dwell)]
    with path.open("xb") as file:
        writer = McapWriter(file, compression=CompressionType.LZ4)
        writer.start(profile="loopcal", library="golden foreign")
        reading = writer.register_schema("loopcal.Reading", "protobuf", schema_data(READING))
        dwell = writer.register_schema("loopcal.Dwell", "protobuf", schema_data(READING))
        note = writer.register_schema("note", "", b"")
        topics = {
            "q1": writer.register_channel("/channel/q1", "protobuf", reading),
            "q2": writer.register_channel("/channel/q2", "protobuf", reading),
            "dwell": writer.register_channel("/session/dwell", "protobuf", dwell),
            "note": writer.register_channel("/note", "json", note),
        }
        for event in found:
            if isinstance(event, Reading):
                payload = messages_pb2.Reading(raw=event.raw).SerializeToString()
                if event.sequence is not None:
                    rest = messages_pb2.Reading(
                        device_time_ns=event.device_time_ns,
                        sequence=event.sequence,
                        flags=event.flags,
                    )
                    payload = rest.SerializeToString() + payload
                writer.add_message(topics[event.channel], event.time_ns, payload, event.time_ns)
            else:
                payload = messages_pb2.Dwell(
                    start_ns=event.start_ns,
                    end_ns=event.end_ns,
                    pose=event.pose,
                    visit=event.visit,
                ).SerializeToString()
                writer.add_message(topics["dwell"], event.time_ns, payload, event.time_ns)
                writer.add_message(topics["note"], event.time_ns, b"{}", event.time_ns)
        writer.add_attachment(0, 0, "rig.toml", "application/toml", RIG.encode())
        writer.finish()
    expect(path, found, session=Session(software=""))


def write_parts(path: Path) -> None:
    """Two files."""
    from recordings.storage import Storage

    found = [e for e in events() if isinstance(e, Reading | Dwell | LedgerEntry)]
    with Writer(path, RIG, SESSION, Storage(rotate_s=0.4)) as writer:
        _write(writer, found)
    assert len(writer.paths) == 2
    expect(path, found)


def _write(writer: Writer, given: Sequence[Event]) -> None:
    for event in given:
        writer.write(event)
        last = isinstance(event, Reading) and event.channel == "q2"
        if last and (event.time_ns - START_NS) // STEP_NS % FLUSH == FLUSH - 1:
            writer.flush()


def expect(
    path: Path,
    given: Sequence[Event],
    *,
    session: Session = SESSION,
    whole: bool = True,
    missing: int = 0,
) -> None:
    """Write down what a reader must find in ``path``.

    Args:
        path: the recording.
        given: events that are in it.
        session: who is said to have recorded it.
        whole: whether it is undamaged.
        missing: readings of each channel that its own numbers show to be missing.
    """
    told: dict[str, Any] = {
        "rig_toml": RIG,
        "session": dataclasses.asdict(session),
        "whole": whole,
        "missing": missing,
        "readings": {},
    }
    for channel in ("q1", "q2"):
        own = [e for e in given if isinstance(e, Reading) and e.channel == channel]
        columns = ("time_ns", "raw", "device_time_ns", "sequence", "flags")
        told["readings"][channel] = {
            name: [getattr(e, name) for e in own] if getattr(own[0], name) is not None else None
            for name in columns
        }
    kinds = (Dwell, Mark, Fault, ModeCommand, ModeReport, ClockSample, LedgerEntry)
    for kind in kinds:
        told[kind.__name__] = [dataclasses.asdict(e) for e in given if isinstance(e, kind)]
    path.with_suffix(".json").write_text(
        json.dumps(told, separators=(",", ":")) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    target = Path(__file__).parent / sys.argv[1]
    if target.exists():
        sys.exit(f"'{target}' exists already; golden recordings are never written again")
    main(target)
