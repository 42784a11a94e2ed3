"""Frames of a DBC encoder taken at once are taken as one by one: readings, losses, silence, doubles."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can_bus import Frame
from drivers.can_link import CanLink
from drivers.dbc.encoder import DbcEncoder, DbcEncoderOptions
from drivers.dbc.layout import Block, SignalLayout
from drivers.dbc.message_watch import MessageWatch
from drivers.driver import DeviceSpec
from drivers.errors import Malformed
from drivers.stream_tally import StreamTally
from recordings.events import Event, Fault, Reading
from recordings.rig import CanPort
from sim_devices.virtual_time import SECOND, VirtualClock

TEXT = (Path(__file__).parent / "bench.dbc").read_text("utf-8")
POSITION = cantools.database.load_string(TEXT, "dbc").get_message_by_name("ElbowPosition")
FULL_NS = 111_000
"""Between two frames of a full bus."""


@st.composite
def layouts(draw: st.DrawFn) -> SignalLayout:
    return SignalLayout(
        "signal",
        start=draw(st.integers(0, 63)),
        length=draw(st.integers(1, 64)),
        little_endian=draw(st.booleans()),
        signed=draw(st.booleans()),
    )


@given(layouts(), st.integers(1, 8).flatmap(lambda n: st.lists(st.binary(min_size=n, max_size=n), min_size=1)))  # fmt: skip
@settings(max_examples=400)
def test_a_column_holds_the_raw_values(layout: SignalLayout, frames: list[bytes]) -> None:
    block = Block(frames, len(frames[0]))
    try:
        expected = [layout.raw(data) for data in frames]
    except Malformed as error:
        with pytest.raises(Malformed, match=str(error)):
            layout.column(block)
    else:
        assert layout.column(block) == expected


@dataclass
class Wire:
    """A bus on which nothing is sent."""

    time_ns: int = 0
    faults: list[tuple[int, str, str]] = field(default_factory=list)

    def now_ns(self) -> int:
        return self.time_ns

    def fault(self, time_ns: int, source: str, kind: str, text: str) -> None:
        self.faults.append((time_ns, source, kind))


def encoder(channel, **options) -> DbcEncoder:
    channels = (channel("q1", "ElbowPosition.Angle"), channel("t", "Temperature"))
    described = DbcEncoderOptions.model_validate(options)
    return DbcEncoder(DeviceSpec("elbow", "dbc-encoder", "bus", None, channels, described, TEXT))


class Sender:
    """What a device sends whose counter and clock are mostly regular, and sometimes anything."""

    def __init__(self, seed: int, mishaps: float) -> None:
        self._random = Random(seed)
        self._mishaps = mishaps
        self._count = self._time = 0

    def data(self) -> bytes:
        count = self._count
        self._count += 1
        self._time += self._random.choice([0, 0, 1])
        if self._random.random() < self._mishaps:
            mishap = self._random.randrange(5)
            if mishap == 0:
                self._count += self._random.choice([1, 2, 50, 300])
            elif mishap == 1:
                self._count -= 1
            elif mishap == 2:
                self._count = self._time = 0
            elif mishap == 3:
                return self._random.randbytes(self._random.randrange(8))
            else:
                self._time += self._random.choice([-3, 40_000])
        values = {"Angle": self._random.choice([-1, 5000, -(1 << 19)]), "Temperature": 4095}
        values |= {"Count": count % 256, "Time": self._time % 65536}
        return POSITION.encode(values, scaling=False)


OPTIONS = [
    {"counter": "Count", "clock": "Time", "clock_tick_us": 1000},
    {"counter": "Count"},
    {"counter": "Count", "invalid": 5000},
    {"counter": "Count", "cycle_ms": 1},
    {"clock": "Time"},
    {},
]


def one_by_one(device: DbcEncoder, frames: list[Frame]) -> list[Event]:
    events: list[Event] = []
    for frame in frames:
        try:
            events += device.receive(frame)
        except Malformed as error:
            events.append(Fault(frame.time_ns, "elbow", "malformed", str(error)))
    return events


def in_turn(events: list[Event]) -> list[tuple[str, Event]]:
    """Channel by channel, each in its order; frames of one moment may be told in any."""
    return sorted(
        ((each.channel if isinstance(each, Reading) else "", each) for each in events),
        key=lambda told: told[0],
    )


@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: "-".join(options) or "none")
@pytest.mark.parametrize("mishaps", [0.0, 0.003, 0.2])
@pytest.mark.parametrize("seed", [1, 2])
def test_at_once_is_as_one_by_one(channel, options, mishaps: float, seed: int) -> None:
    random, sender = Random(seed), Sender(seed, mishaps)
    wires = Wire(), Wire()
    single, together = encoder(channel, **options), encoder(channel, **options)
    for device, wire in zip((single, together), wires, strict=True):
        device.attach(wire)
        device.start()
    taken, time_ns = 0, 0
    for _ in range(300):
        count = random.choice([1, 2, 20, 60])
        time_ns += count * FULL_NS + random.choice([0, 0, 0, SECOND // 3])
        for wire in wires:
            wire.time_ns = time_ns
        frames = [Frame(POSITION.frame_id, sender.data(), time_ns) for _ in range(count)]
        expected = one_by_one(single, frames)
        found = one_by_one(together, frames[:1])
        at_once = together.receive_on(frames[1:]) if count > 1 else None
        taken += at_once is not None
        found += one_by_one(together, frames[1:]) if at_once is None else at_once
        assert in_turn(found) == in_turn(expected)
        assert single.serve(time_ns) == together.serve(time_ns)
        assert single.losses(time_ns) == together.losses(time_ns)
    assert wires[0].faults == wires[1].faults
    if "counter" not in options:
        assert taken == 0
    elif mishaps < 0.1:
        assert taken > 100


@pytest.mark.parametrize("period_ns", [None, FULL_NS])
@pytest.mark.parametrize("seed", range(5))
def test_a_tally_knows_the_same_of_readings_of_one_moment(period_ns: int | None, seed: int) -> None:
    random, time_ns = Random(seed), 0
    single, together = StreamTally(period_ns), StreamTally(period_ns)
    steps = [None, 0, 2, 3, 400, -5]
    for _ in range(2000):
        time_ns += random.choice([FULL_NS, 20 * FULL_NS, SECOND])
        step = random.choice(steps) if random.random() < 0.1 else 1
        for tally in (single, together):
            tally.receive(time_ns, step)
        if not together.steady:
            continue
        count = random.choice([1, 5, 40])
        for _ in range(count):
            single.receive(time_ns, 1)
        together.receive_on(count)
        known, same = vars(single).copy(), vars(together).copy()
        assert known.pop("_mean_ns") == pytest.approx(same.pop("_mean_ns"))
        assert known.pop("_room") == pytest.approx(same.pop("_room"), abs=1e-9)
        assert same.pop("_pauses") <= known.pop("_pauses")  # beyond `MEMORY` they do not count
        assert same == known


def test_a_message_heard_at_once_is_doubled_like_one_heard_singly() -> None:
    single, together = MessageWatch(None), MessageWatch(None)
    for watch in (single, together):
        watch.begin(0)
    changes = []
    for tick in range(1, 200):
        now_ns = tick * SECOND // 50
        count = 40 if tick > 100 else 20
        for _ in range(count):
            single.hear(now_ns)
        together.hear(now_ns)
        together.hear_on(count - 1)
        changes.append((single.doubles(now_ns), together.doubles(now_ns)))
    assert all(one == other for one, other in changes)
    assert (single.doubled, together.doubled) == (True, True)


def test_frames_behind_one_that_makes_no_sense_are_not_of_its_moment(channel) -> None:
    """A frame that is cut short is no reading: what comes with it comes after a pause."""
    device, sender = encoder(channel, counter="Count"), Sender(3, 0.0)
    device.attach(Wire())
    device.start()
    for at in range(200):
        device.receive(Frame(POSITION.frame_id, sender.data(), at * FULL_NS))
    later_ns = 300 * FULL_NS
    others = [Frame(POSITION.frame_id, sender.data(), later_ns) for _ in range(20)]
    with pytest.raises(Malformed):
        device.receive(Frame(POSITION.frame_id, b"", later_ns))
    assert device.receive_on(others) is None
    device.receive(others[0])
    assert len(device.receive_on(others[1:])) == 2 * 19


class Lines:
    """A serial port that gives a text in pieces."""

    def __init__(self, pieces: list[bytes]) -> None:
        self._pieces = pieces

    def read(self, timeout_s: float | None) -> bytes:
        return self._pieces.pop(0) if self._pieces else b""

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_link_takes_blocks_as_it_takes_frames(channel, monkeypatch) -> None:
    port = CanPort(kind="can", name="bus", interface="slcan", channel="socket://nowhere:1")
    sender, told = Sender(7, 0.002), []
    frames = [(POSITION.frame_id, sender.data()) for _ in range(3000)]
    frames = [each for frame in frames for each in (frame, (0x7FF, b"other"))]
    lines = [f"t{identifier:03X}{len(data)}{data.hex()}\r" for identifier, data in frames]
    pieces = ["".join(lines[at : at + 80]).encode() for at in range(0, len(lines), 80)]
    for few in (16, math.inf):
        clock = VirtualClock()
        monkeypatch.setattr("drivers.can_link.FEW_FRAMES", few)
        monkeypatch.setattr("drivers.slcan.open_blocks", lambda *_, **__: Lines(list(pieces)))
        link = CanLink(port, [encoder(channel, counter="Count")], clock)
        link.open()
        link.start(100.0)
        events: list[Event] = []
        for _ in range(2 * len(pieces)):
            events += link.pump(0.0)
            clock.advance(0.002)
        told.append((in_turn(events), link.losses()))
        link.close()
    assert len(told[0][0]) > 5000
    assert told[0] == told[1]
