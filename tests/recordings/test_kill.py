"""kill -9 at any moment: all that was flushed is read, in order, and nothing else.

One process forks the writers and kills them, so that a kill costs milliseconds. Each writer
says after every flush how much it has flushed; a third of them write in parts, and some are
killed while they create the file, turn to the next part, or close it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from recordings.errors import HopelessRecording, NothingReadable
from recordings.reader import read_recording
from recordings.recover import recover
from recordings.survey import survey

KILLS = 120
START_NS = 1_700_000_000_000_000_000
FACTOR = 6364136223846793005

RIG = """
schema = 1
name = "bench"
mechanism = { family = "serial", joint = [{ name = "base", a_m = 0.3 }] }
channel = [{ name = "q1", senses = "base", gain_deg_per_count = 0.01 }]
"""

KILLER = """
import json, os, random, signal, struct, sys, time
from pathlib import Path
from recordings.events import Dwell, Reading
from recordings.session import Session
from recordings.storage import Storage, Sync
from recordings.writer import Writer

folder, rig, kills, start_ns, factor = sys.argv[1], Path(sys.argv[2]).read_text(), *map(int, sys.argv[3:])
rng = random.Random(2024)

def write(path, storage, count, pipe):
    with Writer(path, rig, Session("killed", start_ns), storage) as writer:
        for i in range(count):
            writer.write(Reading("q1", start_ns + i, i * factor % 2**62, sequence=i))
            if i % 20 == 19:
                writer.write(Dwell(start_ns + i, start_ns, start_ns + i, i // 20, 0))
                writer.flush()
                os.write(pipe, struct.pack("<I", i + 1))
    os.write(pipe, struct.pack("<I", 2**31))

told = []
for number in range(kills):
    count = rng.choice([10**6, rng.randrange(1, 400)])
    wait_for, wait_s = rng.choice([0, rng.randrange(30)]), rng.uniform(0, 0.006)
    storage = Storage(sync=Sync.NEVER, rotate_bytes=20_000 if number % 3 == 0 else None)
    path = Path(folder) / f"{number}.mcap"
    read, pipe = os.pipe()
    writer = os.fork()
    if writer == 0:
        os.close(read)
        write(path, storage, count, pipe)
        os._exit(0)
    os.close(pipe)
    said = b""
    while len(said) < 4 * wait_for and (more := os.read(read, 4)):
        said += more
    while not os.path.exists(path):
        pass
    until = time.perf_counter() + wait_s
    while time.perf_counter() < until:
        pass
    os.kill(writer, signal.SIGKILL)
    os.waitpid(writer, 0)
    while more := os.read(read, 4096):
        said += more
    os.close(read)
    flushed = [n for (n,) in struct.iter_unpack("<I", said)]
    closed = bool(flushed) and flushed[-1] == 2**31
    told.append({"flushed": count if closed else max(flushed, default=0), "closed": closed})
json.dump(told, sys.stdout)
"""


@dataclass(frozen=True)
class Killed:
    path: Path
    flushed: int
    closed: bool


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> list[Killed]:
    folder = tmp_path_factory.mktemp("killed")
    rig = tmp_path_factory.mktemp("rig") / "rig.toml"
    rig.write_text(RIG)
    words = [folder, rig, KILLS, START_NS, FACTOR]
    ran = subprocess.run(
        [sys.executable, "-c", KILLER, *map(str, words)],
        capture_output=True,
        text=True,
        check=True,
    )
    told = json.loads(ran.stdout)
    return [Killed(folder / f"{number}.mcap", **each) for number, each in enumerate(told)]


def test_what_was_flushed_is_read_and_nothing_else(killed: list[Killed]) -> None:
    readable = closed = in_parts = 0
    for each in killed:
        try:
            recording = read_recording(each.path, damaged_ok=True)
        except (HopelessRecording, NothingReadable):
            assert each.flushed == 0
            continue
        readable += 1
        raw = recording.readings["q1"].raw
        # What was written and not yet told as flushed may be there as well.
        assert len(raw) >= each.flushed
        assert raw.tolist() == [i * FACTOR % 2**62 for i in range(len(raw))]
        assert [dwell.pose for dwell in recording.dwells] == list(range(len(recording.dwells)))
        if "q1" in recording.ledger:
            assert recording.ledger["q1"].received <= len(raw)
        if each.closed:
            closed += 1
            assert not recording.damage
        in_parts += (each.path.parent / f"{each.path.stem}.002.mcap").exists()
    assert readable > 0.8 * KILLS
    assert closed > 3
    assert in_parts > 3


def test_the_report_of_what_is_missing_is_exact(killed: list[Killed], tmp_path: Path) -> None:
    for number, each in enumerate(killed):
        if each.flushed == 0:
            continue
        found = survey(each.path)
        assert not found.hopeless
        assert {
            topic: tally.missing for topic, tally in found.topics.items() if tally.missing
        } == {}
        if number % 4:
            continue
        before = each.path.read_bytes()
        recover(each.path, tmp_path / f"{number}.mcap")
        assert each.path.read_bytes() == before
        whole = read_recording(tmp_path / f"{number}.mcap")
        left = read_recording(each.path, damaged_ok=True)
        assert np.array_equal(whole.readings["q1"].raw, left.readings["q1"].raw)
        assert whole.dwells == left.dwells
