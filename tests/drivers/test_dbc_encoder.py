"""Sensors that a DBC file describes: readings, exact and estimated losses, silence, restarts."""

from __future__ import annotations

from pathlib import Path

import cantools
import pytest

from drivers.can_link import CanLink
from drivers.dbc.encoder import DbcEncoder, DbcEncoderOptions
from drivers.driver import DeviceSpec
from drivers.errors import OptionError
from drivers.link import Losses
from recordings.events import Fault, Reading, ReadingFlag
from recordings.faults import FaultKind

TEXT = (Path(__file__).parent / "bench.dbc").read_text("utf-8")
THEIRS = cantools.database.load_string(TEXT, "dbc")
POSITION = THEIRS.get_message_by_name("ElbowPosition")
PAGED = THEIRS.get_message_by_name("Multiplexed")
COUNTED = {"counter": "Count", "clock": "Time", "clock_tick_us": 1000}


@pytest.fixture
def make(can_port, clock, channel, bus):
    """Makes and opens a link with one dbc-encoder; gives the bus beside it."""
    links = []

    def make(*channels, **options):
        spec = DeviceSpec(
            "elbow",
            "dbc-encoder",
            "bus",
            None,
            tuple(channel(name, signal) for name, signal in channels),
            DbcEncoderOptions.model_validate(options),
            TEXT,
        )
        link = CanLink(can_port, [DbcEncoder(spec)], clock, connect=bus.connect)
        links.append(link)
        link.open()
        return link

    yield make
    for link in links:
        link.close()


def position(bus, raw: int, count: int = 0, time: int = 0) -> None:
    values = {"Angle": raw, "Temperature": 7, "Count": count % 256, "Time": time % 65536}
    bus.push(POSITION.frame_id, POSITION.encode(values, scaling=False))


def test_raw_counts_are_read_with_counter_and_time(make, bus, clock):
    link = make(("q1", "ElbowPosition.Angle"), ("t", "Temperature"), **COUNTED)
    link.start(100.0)
    events = []
    for n in range(3):
        position(bus, -5000 + n, 254 + n, 65530 + 10 * n)
        events += link.pump(0.0)
        clock.advance(0.01)
    angle = [e for e in events if e.channel == "q1"]
    assert [r.raw for r in angle] == [-5000, -4999, -4998]
    assert [r.sequence for r in angle] == [254, 255, 256]
    assert angle[2].device_time_ns - angle[0].device_time_ns == 20_000_000
    assert [e.raw for e in events if e.channel == "t"] == [7, 7, 7]
    link.stop()
    assert link.losses() == {"q1": Losses(3, 0, 0, 0), "t": Losses(3, 0, 0, 0)}
    assert bus.sent == []


@pytest.mark.parametrize("lost", [1, 100, 255, 256, 700])
def test_losses_by_the_counter_are_exact_also_over_its_wraps(make, bus, clock, lost):
    link = make(("q1", "Angle"), **COUNTED)
    link.start(100.0)
    position(bus, 1, 250, 0)
    link.pump(0.0)
    clock.advance(0.01 * (lost + 1))
    position(bus, 2, 250 + lost + 1, 10 * (lost + 1))
    events = link.pump(0.0)
    assert events[-1].sequence == 250 + lost + 1
    losses = link.losses()["q1"]
    assert (losses.expected, losses.lost_in_gaps, losses.gaps) == (lost + 2, lost, 1)


def test_without_a_counter_losses_follow_from_the_cycle_time(make, bus, clock):
    link = make(("q1", "Angle"))
    link.start(100.0)
    for pause in (0.01, 0.011, 0.009, 0.03, 0.01):
        clock.advance(pause)
        position(bus, 1)
        link.pump(0.0)
    assert link.losses()["q1"] == Losses(7, 2, 0, 0)


def test_a_burst_after_a_pause_of_the_host_is_no_loss(make, bus, clock):
    link = make(("q1", "Angle"))
    link.start(100.0)
    clock.advance(0.01)
    position(bus, 1)
    link.pump(0.0)
    clock.advance(0.05)
    for _ in range(5):
        position(bus, 1)
    assert sum(isinstance(e, Reading) for e in link.pump(0.0)) == 5
    assert link.losses()["q1"] == Losses(6, 0, 0, 0)


def test_silence_is_told_by_the_cycle_time_and_counted_while_it_lasts(make, bus, clock):
    link = make(("q1", "Angle"), **COUNTED)
    link.start(100.0)
    position(bus, 1, 10, 0)
    link.pump(0.0)
    for _ in range(9):
        clock.advance(0.01)
        assert link.pump(0.0) == []
    clock.advance(0.02)
    (silent,) = link.pump(0.0)
    assert (silent.source, silent.kind) == ("elbow", FaultKind.SILENT)
    assert "has not sent ElbowPosition for 0.1 s" in silent.text
    assert link.losses()["q1"].dropped_by_device == 10
    clock.advance(0.89)
    assert link.pump(0.0) == []
    position(bus, 1, 10 + 100, 1000)
    back, reading = link.pump(0.0)
    assert (back.kind, reading.raw) == (FaultKind.ANSWERING, 1)
    assert link.losses()["q1"] == Losses(101, 0, 99, 1)


def test_a_host_that_was_held_up_reads_what_waits_before_it_calls_anything_silent(make, bus, clock):
    link = make(("q1", "Angle"), **COUNTED)
    link.start(100.0)
    position(bus, 1, 10, 0)
    link.pump(0.0)
    clock.advance(0.3)
    for n in range(1, 31):
        position(bus, 1, 10 + n, 10 * n)
    assert [type(e) for e in link.pump(0.0)] == [Reading] * 30
    assert link.losses()["q1"] == Losses(31, 0, 0, 0)


def test_a_restart_is_told_by_the_clock_and_counts_no_losses_of_its_counter(make, bus, clock):
    link = make(("q1", "Angle"), **COUNTED)
    link.start(100.0)
    position(bus, 1, 200, 30_000)
    link.pump(0.0)
    clock.advance(0.05)
    position(bus, 2, 3, 20)
    fault, reading = link.pump(0.0)
    assert (fault.source, fault.kind) == ("elbow", FaultKind.RESTARTED)
    assert (reading.sequence, reading.device_time_ns) == (3, 20_000_000)
    assert link.losses()["q1"] == Losses(6, 4, 0, 0)  # by the cycle time: 5 periods, 1 came


def test_a_message_sent_twice_is_stale(make, bus, clock):
    link = make(("q1", "Angle"), **COUNTED)
    link.start(100.0)
    for _ in range(2):
        position(bus, 5, 9, 90)
    flags = [event.flags for event in link.pump(0.0)]
    assert flags == [ReadingFlag.NONE, ReadingFlag.STALE]


def test_a_value_that_means_not_available_is_flagged(make, bus, clock):
    link = make(("q1", "Angle"), invalid=-524_288)
    link.start(100.0)
    position(bus, -524_288)
    (reading,) = link.pump(0.0)
    assert reading.flags == ReadingFlag.DEVICE_ERROR


def test_multiplexed_signals_come_from_the_frames_that_have_them(make, bus, clock):
    link = make(("wrist", "Multiplexed.Wrist"), ("finger", "Finger"), timeout_s=2.0)
    link.start(100.0)
    for values in ({"Page": 0, "Wrist": -70_000}, {"Page": 1, "Finger": 40_000}):
        data = PAGED.encode(values, scaling=False)
        bus.push(PAGED.frame_id | 1 << 31, data)
    assert [(e.channel, e.raw) for e in link.pump(0.0)] == [("wrist", -70_000), ("finger", 40_000)]


def test_a_frame_that_is_too_short_is_malformed_and_not_fatal(make, bus, clock):
    link = make(("q1", "Angle"))
    link.start(100.0)
    bus.push(POSITION.frame_id, b"\1\2")
    position(bus, 5)
    fault, reading = link.pump(0.0)
    assert (fault.source, fault.kind) == ("elbow", FaultKind.MALFORMED)
    assert reading.raw == 5


def test_an_unplugged_bus_is_a_gap_with_exact_losses(make, bus, clock):
    link = make(("q1", "Angle"), **COUNTED)
    link.start(100.0)
    position(bus, 1, 0, 0)
    link.pump(0.0)
    bus.plugged = False
    kinds = [e.kind for e in link.pump(0.0)]
    clock.advance(1.0)
    assert link.losses()["q1"].lost_in_gaps == 99
    bus.plugged = True
    position(bus, 1, 101, 1010)
    clock.advance(0.01)
    for _ in range(3):
        kinds += [e.kind if isinstance(e, Fault) else "reading" for e in link.pump(0.0)]
    assert kinds == [FaultKind.BROKEN, FaultKind.REOPENED, "reading"]
    assert link.losses()["q1"] == Losses(102, 0, 100, 1)


def test_the_check_waits_for_every_message(make, bus):
    link = make(("q1", "Angle"), ("wrist", "Wrist"), timeout_s=0.3)
    position(bus, 1)
    (status,) = link.check()
    assert not status.answers
    assert "has not sent Multiplexed (identifier 0x18FF04FE)" in status.problem
    bus.push(PAGED.frame_id | 1 << 31, bytes(8))
    position(bus, 1)
    (status,) = link.check()
    assert status.answers
    assert status.identity == "sends ElbowPosition, Multiplexed"
    assert not status.virtual


@pytest.mark.parametrize(
    ("channels", "options", "words"),
    [
        ((("q1", 3),), {}, "'signal' is 3, expected \"MESSAGE.SIGNAL\""),
        ((("q1", "Angle"),), {"counter": "Cuont"}, "'counter' is 'Cuont'.* Angle, Temperature"),
        ((), {}, "delivers no channel"),
    ],
)
def test_wrong_descriptions(make, channels, options, words):
    with pytest.raises(OptionError, match=words):
        make(*channels, **options)
