"""What is left of damaged recordings, beside the mcap library: python benchmarks/recover.py

One recording (7 channels at 100 Hz, a minute, flushed four times a second, as a capture does) is
damaged in every way of a table, many times with other random numbers, and each file is read by

- `loopcal recover`, and what it wrote by the mcap library;
- the mcap library's StreamReader with CRCs, message by message until it raises: what a recovery
  that stops at the first damaged chunk saves;
- the mcap library's indexed reader, which most tools open a file with;
- `mcap recover`, where that program is on the PATH.

Shown: messages saved, of those in the undamaged file; mean and worst file. Beside it how many
files had their losses told exactly: as many readings missing as there really are, where the
messages' own numbers can tell (the end that was cut off is known only as far as a ledger of it).

Ends with exit code 1 where a file gives less than the mcap library saves of it, or is miscounted.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from monte_carlo import console
from rich.progress import track
from rich.table import Table

from recordings.errors import RecordingsError
from recordings.events import Reading
from recordings.reader import read_recording
from recordings.recover import recover
from recordings.rig import rig_text
from recordings.session import Session
from recordings.writer import Writer

CHANNELS = tuple(f"q{number}" for number in range(1, 8))
START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
HZ, FLUSHES = 100, 4

Damage = Callable[[bytearray, np.random.Generator], bytearray]


def write(path: Path, seconds: int) -> None:
    """Readings in the order in which they come; reading i of a channel has the count i."""
    with Writer(path, rig_text("arm")[0], Session("benchmark", START_NS)) as writer:
        for i in range(seconds * HZ):
            for place, channel in enumerate(CHANNELS):
                writer.write(Reading(channel, START_NS + i * STEP_NS + place, i, 7 * i, i))
            if i % (HZ // FLUSHES) == HZ // FLUSHES - 1:
                writer.flush()


def killed(data: bytearray, rng: np.random.Generator) -> bytearray:
    return data[: int(rng.integers(len(data) // 10, len(data)))]


def flipped(count: int) -> Damage:
    def damage(data: bytearray, rng: np.random.Generator) -> bytearray:
        for place in rng.integers(0, len(data), count).tolist():
            data[place] ^= 1 << int(rng.integers(8))
        return data

    return damage


def hole(size: int) -> Damage:
    def damage(data: bytearray, rng: np.random.Generator) -> bytearray:
        start = int(rng.integers(0, len(data) - size)) // size * size
        data[start : start + size] = bytes(size)
        return data

    return damage


def first_page(data: bytearray, rng: np.random.Generator) -> bytearray:
    data[:4096] = bytes(4096)
    return data


def zero_tail(data: bytearray, rng: np.random.Generator) -> bytearray:
    cut = int(rng.integers(len(data) // 2, len(data)))
    return data[:cut] + bytes(len(data) - cut)


def killed_and_flipped(data: bytearray, rng: np.random.Generator) -> bytearray:
    return flipped(3)(killed(data, rng), rng)


KINDS: dict[str, Damage] = {
    "killed: cut anywhere": killed,
    "one wrong bit": flipped(1),
    "ten wrong bits": flipped(10),
    "killed, and three wrong bits": killed_and_flipped,
    "a page of 4 KiB lost": hole(4096),
    "64 KiB lost": hole(65536),
    "the first page lost": first_page,
    "zeros from somewhere to the end": zero_tail,
}


def by_library(path: Path) -> int:
    """Messages that the streaming reader gives before it stops."""
    count = 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                count += isinstance(record, Message)
        except Exception:  # noqa: BLE001 - it raises McapError, struct.error, zstd's own, ...
            return count
    return count


def by_index(path: Path) -> int:
    """Messages that the indexed reader gives before it stops."""
    count = 0
    with path.open("rb") as file:
        try:
            for _ in make_reader(file, validate_crcs=True).iter_messages():
                count += 1
        except Exception:  # noqa: BLE001 - as above
            return count
    return count


def by_program(path: Path, folder: Path) -> int:
    """Messages that `mcap recover` saves."""
    target = folder / "by-program.mcap"
    target.unlink(missing_ok=True)
    subprocess.run(["mcap", "recover", path, "-o", target], capture_output=True, check=False)
    return by_library(target) if target.exists() else 0


@dataclass(frozen=True, slots=True)
class Outcome:
    """Messages that each saved, and whether the losses were told exactly."""

    ours: int
    library: int
    indexed: int
    program: int | None
    exact: bool


def outcome(path: Path, folder: Path) -> Outcome:
    """Read one damaged file in every way."""
    target = folder / "recovered.mcap"
    target.unlink(missing_ok=True)
    ours, exact = 0, True
    try:
        done = recover(path, target)
    except RecordingsError:
        pass
    else:
        ours = by_library(target)
        whole = read_recording(target)
        for channel in CHANNELS:
            raw = whole.readings[channel].raw.tolist()
            tally = done.found.channel(channel)
            missing = {hole.first + k for hole in tally.holes for k in range(hole.count)}
            exact &= missing == set(range(tally.next or 0)) - set(raw)
    program = by_program(path, folder) if shutil.which("mcap") else None
    return Outcome(ours, by_library(path), by_index(path), program, exact)


def main() -> int:
    words = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    words.add_argument("--files", type=int, default=25, help="damaged files of each kind")
    words.add_argument("--seconds", type=int, default=60, help="length of the recording")
    given = words.parse_args()
    well = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder / "whole.mcap", given.seconds)
        data = (folder / "whole.mcap").read_bytes()
        total = by_library(folder / "whole.mcap")
        heads = ["damage", "loopcal recover", "StreamReader", "indexed reader"]
        with_program = shutil.which("mcap") is not None
        heads += ["mcap recover"] if with_program else []
        table = Table(
            *heads, "counted exactly", title=f"{total} messages, {len(data) / 1e6:.1f} MB"
        )
        for number, (kind, damage) in enumerate(KINDS.items()):
            rng = np.random.default_rng([number, 1])
            found = []
            for _ in track(range(given.files), kind, console=console, transient=True):
                path = folder / "damaged.mcap"
                path.write_bytes(damage(bytearray(data), rng))
                found.append(outcome(path, folder))
            well &= all(each.exact and each.ours >= each.library for each in found)
            columns = [[x.ours for x in found], [x.library for x in found]]
            columns.append([x.indexed for x in found])
            columns += [[x.program or 0 for x in found]] if with_program else []
            shown = [
                f"{100 * np.mean(saved) / total:.1f} % ({100 * min(saved) / total:.1f})"
                for saved in columns
            ]
            exact = sum(each.exact for each in found)
            table.add_row(kind, *shown, f"{exact} of {len(found)}")
        console.print(table)
    if not well:
        console.print("[red]a file gave less than the mcap library saves, or was miscounted[/red]")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
