"""How fast recordings are read, beside mcap's own reader: python benchmarks/bulk_reading.py

Every file of a table of shapes is read by `read_recording` and, in turns with it, by the mcap
library's reader with protobuf decoding. The library's side iterates over the decoded messages
in file order, its fastest way, checks no CRC and keeps nothing; ours checks every CRC and ends
with sorted columns. Times are processor time of one thread, the best of the rounds; ours is in each
the mean of several readings, as many as take a good part of the library's one, so that what else
the machine does meets both. Both sides are checked to see the same number of readings and the same
sum of counts.

Ends with exit code 1 where any shape is read less than 20 times faster.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.decoder import DecoderFactory
from monte_carlo import console
from numpy.typing import NDArray
from rich.progress import track
from rich.table import Table

from recordings import messages_pb2
from recordings.events import Reading
from recordings.reader import read_recording
from recordings.rig import rig_text
from recordings.session import Session
from recordings.writer import Writer

LIMIT = 20.0
REPEATS = 10
"""Readings by this program for each one by the library."""

CHANNELS = tuple(f"q{number}" for number in range(1, 8))
START_NS = 1_700_000_000_000_000_000
STEP_NS = 1_000_000
SECOND = 1000
"""Readings of a channel in a second."""

FLUSHED = SECOND // 4
"""Readings of a channel between two flushes of a session."""


@dataclass(frozen=True, slots=True)
class Second:
    """One second of one channel, columns of 1000."""

    channel: str
    time_ns: NDArray[np.int64]
    raw: NDArray[np.int64]
    sequence: NDArray[np.int64]


def seconds(count: int) -> Iterator[list[Second]]:
    """Seven noisy channels at 1 kHz, a second at a time."""
    rng = np.random.default_rng(1)
    level = rng.integers(0, 400_000, len(CHANNELS))
    for second in range(count):
        numbers = second * SECOND + np.arange(SECOND)
        yield [
            Second(
                channel,
                START_NS + numbers * STEP_NS + rng.integers(0, 100_000, SECOND) + 1000 * place,
                level[place] + np.rint(rng.normal(0, 3, SECOND)).astype(np.int64),
                numbers,
            )
            for place, channel in enumerate(CHANNELS)
        ]


def interleaved(parts: list[Second]) -> Iterator[tuple[str, int, int, int]]:
    """Channel, time, count, number: reading by reading as they arrive from a bus."""
    columns = [
        zip(*(c.tolist() for c in (p.time_ns, p.raw, p.sequence)), strict=True) for p in parts
    ]
    for row in zip(*columns, strict=True):
        for part, values in zip(parts, row, strict=True):
            yield part.channel, *values


def in_turns(path: Path, rig: str, count: int) -> None:
    """By arrays of a second, as `loopcal simulate` and `loopcal import` write."""
    with Writer(path, rig, Session(start_ns=START_NS)) as writer:
        for parts in seconds(count):
            for part in parts:
                writer.write_readings(
                    part.channel, part.time_ns, part.raw, part.time_ns - START_NS, part.sequence
                )


def captured(path: Path, rig: str, count: int) -> None:
    """By arrays of a quarter of a second, and flushed as often, as a session writes."""
    with Writer(path, rig, Session(start_ns=START_NS)) as writer:
        for parts in seconds(count):
            for first in range(0, SECOND, FLUSHED):
                some = slice(first, first + FLUSHED)
                for part in parts:
                    time_ns, raw, number = (
                        column[some] for column in (part.time_ns, part.raw, part.sequence)
                    )
                    writer.write_readings(part.channel, time_ns, raw, time_ns - START_NS, number)
                writer.flush()


def one_by_one(path: Path, rig: str, count: int) -> None:
    """Reading by reading, channels interleaved, flushed four times a second."""
    with Writer(path, rig, Session(start_ns=START_NS)) as writer:
        for parts in seconds(count):
            for number, (channel, time_ns, raw, sequence) in enumerate(interleaved(parts), 1):
                writer.write(Reading(channel, time_ns, raw, time_ns - START_NS, sequence))
                if number % (FLUSHED * len(CHANNELS)) == 0:
                    writer.flush()


def bare(path: Path, rig: str, count: int) -> None:
    """Reading by reading, one device in two without a clock or a counter."""
    with Writer(path, rig, Session(start_ns=START_NS)) as writer:
        for parts in seconds(count):
            for channel, time_ns, raw, sequence in interleaved(parts):
                own = channel in CHANNELS[::2]
                writer.write(Reading(channel, time_ns, raw, None, sequence if own else None))


def foreign(**options: object) -> Callable[[Path, str, int], None]:
    """By the mcap library, channels interleaved."""

    def write(path: Path, rig: str, count: int) -> None:
        described = FileDescriptorSet()
        messages_pb2.DESCRIPTOR.CopyToProto(described.file.add())
        with path.open("xb") as file:
            writer = McapWriter(file, **options)  # type: ignore[arg-type]
            writer.start(profile="loopcal", library="mcap")
            writer.add_attachment(0, 0, "rig.toml", "application/toml", rig.encode())
            schema = writer.register_schema(
                "loopcal.Reading", "protobuf", described.SerializeToString()
            )
            ids = {
                name: writer.register_channel(f"/channel/{name}", "protobuf", schema)
                for name in CHANNELS
            }
            for parts in seconds(count):
                for channel, time_ns, raw, sequence in interleaved(parts):
                    message = messages_pb2.Reading(raw=raw, sequence=sequence, flags=0)
                    writer.add_message(ids[channel], time_ns, message.SerializeToString(), time_ns)
            writer.finish()

    return write


@dataclass(frozen=True, slots=True)
class Shape:
    """A way of writing the same readings."""

    name: str
    write: Callable[[Path, str, int], None]


_64_KIB = 64 * 1024
SHAPES = (
    Shape("by arrays, 256 KiB, zstd", in_turns),
    Shape("as captured, 250 ms, zstd", captured),
    Shape("one by one, interleaved, 250 ms, zstd", one_by_one),
    Shape("one by one, without device time", bare),
    Shape("mcap library, 64 KiB, zstd", foreign(chunk_size=_64_KIB)),
    Shape(
        "mcap library, 64 KiB, lz4", foreign(chunk_size=_64_KIB, compression=CompressionType.LZ4)
    ),
    Shape(
        "mcap library, 64 KiB, none", foreign(chunk_size=_64_KIB, compression=CompressionType.NONE)
    ),
    Shape("mcap library, 1 MiB, zstd", foreign(chunk_size=1 << 20)),
    Shape("mcap library, 4 KiB, zstd", foreign(chunk_size=4096)),
    Shape("mcap library, no chunks", foreign(use_chunking=False)),
)


def read_here(path: Path) -> tuple[int, int]:
    """Number of readings and sum of their counts, by this program."""
    readings = read_recording(path).readings.values()
    return sum(map(len, readings)), sum(int(part.raw.sum()) for part in readings)


def read_there(path: Path) -> tuple[int, int]:
    """The same by the mcap library."""
    count = total = 0
    topics = [f"/channel/{name}" for name in CHANNELS]
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for found in reader.iter_decoded_messages(topics, log_time_order=False):
            count += 1
            total += found.decoded_message.raw
    return count, total


def timed(
    read: Callable[[Path], tuple[int, int]], path: Path, times: int
) -> tuple[float, tuple[int, int]]:
    """Processor time of one reading [s], and what was read."""
    began = time.process_time()
    for _ in range(times):
        found = read(path)
    return (time.process_time() - began) / times, found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="length of each file (7 kHz)")
    parser.add_argument("--rounds", type=int, default=3, help="readings of each file")
    given = parser.parse_args()
    rig, _ = rig_text("arm")
    table = Table("file", "MB", "here [µs]", "mcap [µs]", "ratio", "lowest of rounds")
    met = True
    with tempfile.TemporaryDirectory() as folder:
        for shape in track(SHAPES, "shapes of file", console=console):
            path = Path(folder) / "a.mcap"
            shape.write(path, rig, given.seconds)
            here, there = [], []
            for _ in range(given.rounds):
                spent, ours = timed(read_here, path, REPEATS)
                here.append(spent)
                spent, theirs = timed(read_there, path, 1)
                there.append(spent)
                if ours != theirs:
                    raise SystemExit(f"{shape.name}: {ours} here, {theirs} by the mcap library")
            count = ours[0]
            ratio = min(there) / min(here)
            lowest = min(t / h for t, h in zip(there, here, strict=True))
            met = met and ratio >= LIMIT
            table.add_row(
                shape.name,
                f"{path.stat().st_size / 1e6:.1f}",
                f"{min(here) / count * 1e6:.3f}",
                f"{min(there) / count * 1e6:.2f}",
                f"{ratio:.1f}",
                f"{lowest:.1f}",
            )
            path.unlink()
    console.print(table)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
