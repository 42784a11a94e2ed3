"""The Modbus link against scripted slaves (late, foreign, damaged replies) on a stream in memory."""

from __future__ import annotations

import random

import pytest

from drivers.driver import DeviceSpec
from drivers.errors import LinkClosed
from drivers.link import Losses
from drivers.modbus.adc import AdcOptions, ModbusAdc
from drivers.modbus.link import ModbusLink
from recordings.events import Fault, Reading, ReadingFlag
from recordings.faults import FaultKind
from recordings.rig import SerialPort
from sim_devices.virtual_time import time_is
from tests.drivers.modbus_wire import Adc, Wire, frame

HZ = 50.0
STEP_S = 1 / HZ
TIMEOUT_S = 0.02


PORT = SerialPort(kind="serial", name="line", path="/nowhere")
OPTIONS = {"unit_id": 1, "channels": 2, "first_register": 1, "counter_register": 0,
           "timeout_s": TIMEOUT_S}  # fmt: skip


@pytest.fixture
def adc(channel):
    def make(name="adc", prefix="d", **options) -> ModbusAdc:
        valid = AdcOptions.model_validate({**OPTIONS, **options})
        channels = (
            channel(f"{prefix}1", 0, count_range=(0, 4095)),
            channel(f"{prefix}2", 1, count_range=(-10, 10)),
        )
        return ModbusAdc(
            DeviceSpec(name, "modbus-adc", "line", None, channels[: valid.channels], valid)
        )

    return make


@pytest.fixture
def make_link(clock):
    links = []

    def make(wire, *devices, start=True) -> ModbusLink:
        link = ModbusLink(PORT, devices, clock, wire.connect)
        links.append(link)
        link.open()
        if start:
            link.start(HZ)
        return link

    yield make
    for link in links:
        link.close()


@pytest.fixture
def run(clock):
    """Pumps ``steps`` samples; returns readings of d1 (or another channel) and faults."""

    def pump(link, steps: int, name: str = "d1") -> tuple[list[Reading], list[Fault]]:
        readings, faults = [], []
        for _ in range(steps):
            for event in link.pump(0.0):
                if isinstance(event, Fault):
                    faults.append(event)
                elif isinstance(event, Reading) and event.channel == name:
                    readings.append(event)
            clock.advance(STEP_S)
        return readings, faults

    return pump


def test_one_read_gives_counter_and_signals(make_link, adc, clock):
    wire = Wire(Adc())
    link = make_link(wire, adc())
    first, second = link.pump(0.0)
    assert (first.channel, first.raw, first.sequence) == ("d1", 1001, 1)
    assert (second.channel, second.raw, second.sequence) == ("d2", -2, 1)
    assert first.time_ns == clock.now_ns()
    assert wire.requests == [frame(1, 4, 0, 0, 0, 3)]


def test_polls_follow_the_schedule(make_link, adc, run):
    wire = Wire(Adc())
    link = make_link(wire, adc())
    readings, faults = run(link, 10)
    assert [r.raw for r in readings] == list(range(1001, 1011))
    assert link.pump(0.0) != []
    assert link.pump(0.0) == []
    assert faults == []
    assert link.losses() == {"d1": Losses(11, 0, 0, 0), "d2": Losses(11, 0, 0, 0)}


def test_a_late_reply_is_never_taken_for_another_sample(make_link, adc, run):
    wire = Wire(Adc())
    link = make_link(wire, adc())

    def hold_back_the_third(number: int, reply: bytes) -> bytes:
        if number == 3:
            wire.held = reply
            return b""
        return reply

    wire.mangle = hold_back_the_third
    readings, faults = run(link, 6)
    # Sample 3 came when the request after it was under way. That one asked for one register
    # only (sample 4), so that it could not be mistaken; sample 5 is the next that was read.
    assert [r.raw for r in readings] == [1001, 1002, 1005, 1006, 1007]
    assert wire.requests[3] == frame(1, 4, 0, 0, 0, 1)
    assert [f.kind for f in faults] == [FaultKind.SILENT, FaultKind.LATE, FaultKind.ANSWERING] or [
        f.kind for f in faults
    ] == [FaultKind.SILENT, FaultKind.ANSWERING, FaultKind.LATE]
    assert link.losses()["d1"] == Losses(6, 1, 0, 0)


def test_replies_that_are_late_at_random_never_give_a_wrong_reading(make_link, adc, clock):
    slave = Adc()
    wire = Wire(slave)
    link = make_link(wire, adc())
    chance = random.Random(7)

    def sometimes_late(number: int, reply: bytes) -> bytes:
        if chance.random() < 0.3:
            wire.held = reply
            return b""
        return reply

    wire.mangle = sometimes_late
    received = 0
    for _ in range(80):
        for reading in link.pump(0.0):
            if reading.__class__ is Reading and reading.channel == "d1":
                # The slave's latest sample is the one taken for the latest request.
                assert reading.sequence == slave.samples
                received += 1
        clock.advance(STEP_S)
    losses = link.losses()["d1"]
    assert losses.expected - received == losses.dropped_by_device == 80 - received
    assert 20 < received < 70


def test_a_slave_that_is_always_one_reply_behind_gives_no_reading(make_link, adc, run):
    wire = Wire(Adc())
    lag: list[bytes] = []

    def one_behind(number: int, reply: bytes) -> bytes:
        lag.append(reply)
        return lag.pop(0) if len(lag) > 1 else b""

    wire.mangle = one_behind
    link = make_link(wire, adc())
    assert run(link, 20)[0] == []
    assert link.losses()["d1"] == Losses(20, 20, 0, 0)


def test_a_reply_that_came_while_the_host_was_held_up_is_read(make_link, adc, run, clock):
    wire = Wire(Adc())
    link = make_link(wire, adc())
    wire.mangle = lambda number, reply: held.append(reply) or b""
    held: list[bytes] = []
    read = wire.read

    def sleep_for_seconds_before_it_comes(timeout_s: float | None) -> bytes:
        data = read(timeout_s)
        clock.advance(0.01)
        if not data and held:
            clock.advance(3.0)
            wire.arrive(held.pop())
        return data

    wire.read = sleep_for_seconds_before_it_comes
    with time_is(clock):
        readings, faults = run(link, 2)
    assert [r.raw for r in readings] == [1001, 1002]
    assert faults == []


def test_a_reply_that_waits_before_the_request_is_dropped(make_link, adc, run):
    wire = Wire(Adc())
    link = make_link(wire, adc())
    wire.arrive(frame(1, 4, 6, 0, 0, 9, 9, 9, 9))
    readings, faults = run(link, 1)
    assert [r.raw for r in readings] == [1001]
    assert [f.kind for f in faults] == [FaultKind.LATE]


@pytest.mark.parametrize(
    ("noise", "kinds"),
    [
        (b"\x00\xff", set()),
        (frame(2, 4, 6, 0, 0, 9, 9, 9, 9), {FaultKind.FOREIGN}),  # another unit
        (frame(1, 3, 6, 0, 0, 9, 9, 9, 9), set()),  # another function
        (frame(1, 4, 0, 0, 0, 3), set()),  # the echo of the request
    ],
)
def test_foreign_frames_and_noise_are_passed_over(make_link, adc, run, noise, kinds):
    wire = Wire(Adc())
    wire.mangle = lambda number, reply: noise + reply
    readings, faults = run(make_link(wire, adc()), 3)
    assert [r.raw for r in readings] == [1001, 1002, 1003]
    assert {f.kind for f in faults} == kinds


def test_a_damaged_reply_is_a_fault_and_one_reading_lost(make_link, adc, run):
    wire = Wire(Adc())
    wire.mangle = lambda number, reply: reply[:-1] + b"\0" if number == 2 else reply
    link = make_link(wire, adc())
    readings, faults = run(link, 4)
    assert len(readings) == 3
    assert [f.kind for f in faults] == [FaultKind.MALFORMED]
    assert "wrong checksum" in faults[0].text
    assert link.losses()["d1"] == Losses(4, 1, 0, 0)


def test_a_silent_device_is_reported_once_and_when_it_is_back(make_link, adc, run):
    slave = Adc()
    wire = Wire(slave)
    link = make_link(wire, adc())
    run(link, 2)
    slave.unit = 9
    readings, faults = run(link, 5)
    assert readings == []
    assert [(f.source, f.kind) for f in faults] == [("adc", FaultKind.SILENT)]
    assert "unit 1 sent no reply within 0.02 s" in faults[0].text
    slave.unit = 1
    readings, faults = run(link, 2)
    assert len(readings) == 2
    assert [f.kind for f in faults] == [FaultKind.ANSWERING]
    assert link.losses()["d1"] == Losses(9, 5, 0, 0)


def test_a_refusal_is_reported(make_link, adc, run):
    wire = Wire(Adc())
    link = make_link(wire, adc(function=3))
    readings, faults = run(link, 2)
    assert readings == []
    assert [f.kind for f in faults] == [FaultKind.REFUSED]
    assert "Modbus exception 1 (illegal function)" in faults[0].text


def test_a_counter_that_stands_still_is_stale(make_link, adc, run):
    slave = Adc()
    link = make_link(Wire(slave), adc())
    run(link, 1)
    slave.frozen = True
    (reading,), _ = run(link, 1)
    assert reading.flags == ReadingFlag.STALE


def test_the_counter_goes_on_across_its_wrap(make_link, adc, run):
    slave = Adc()
    slave.samples = 65534
    readings, _ = run(make_link(Wire(slave), adc()), 3)
    assert [r.sequence for r in readings] == [65535, 65536, 65537]


def test_a_converter_without_a_counter(make_link, adc, run):
    wire = Wire(Adc())
    wire.mangle = lambda number, reply: b"" if number == 1 else reply
    link = make_link(wire, adc(counter_register=None, channels=1))
    readings, _ = run(link, 3)
    assert [(r.raw, r.sequence) for r in readings] == [(1003, None), (1004, None)]
    # With one register to read, the proof asks for two.
    assert wire.requests[1] == frame(1, 4, 0, 1, 0, 2)


def test_instants_that_the_host_missed_are_a_gap(make_link, adc, run, clock):
    link = make_link(Wire(Adc()), adc())
    run(link, 1)
    clock.advance(19 * STEP_S)
    run(link, 6)  # 20 instants are waiting, 5 of them not too late to be served
    assert link.losses()["d1"] == Losses(21, 0, 14, 1)


def test_two_devices_on_one_line(make_link, adc, run):
    wire = Wire(Adc(1), Adc(2))
    link = make_link(wire, adc(), adc("adc2", "e", unit_id=2))
    readings, _ = run(link, 3, "e1")
    assert [r.raw for r in readings] == [1001, 1002, 1003]
    assert [r[0] for r in wire.requests] == [1, 2] * 3


def test_an_unplugged_line_is_reported_reopened_and_accounted_for(make_link, adc, run):
    wire = Wire(Adc())
    link = make_link(wire, adc())
    before, _ = run(link, 20)
    wire.plugged = False
    none, gone = run(link, 500)
    wire.plugged = True
    after, back = run(link, 300)
    assert none == []
    assert [(f.source, f.kind) for f in gone + back] == [
        ("line", FaultKind.BROKEN),
        ("line", FaultKind.REOPENED),
    ]
    losses = link.losses()["d1"]
    assert losses.expected == 820
    assert losses.expected - len(before) - len(after) == losses.lost_in_gaps
    assert (losses.dropped_by_device, losses.gaps) == (0, 1)


def test_check_names_who_answers(make_link, adc):
    wire = Wire(Adc(1))
    link = make_link(wire, adc(), adc("adc2", "e", unit_id=2), start=False)
    here, missing = link.check()
    assert (here.answers, here.channels, here.identity, here.problem) == (
        True,
        ("d1", "d2"),
        "",
        "",
    )
    assert (missing.answers, missing.channels) == (False, ("e1", "e2"))
    assert "unit 2 sent no reply" in missing.problem


def test_check_shows_the_identification(make_link, adc):
    wire = Wire(Adc())
    body = [1, 43, 14, 1, 0x81, 0, 0, 1, 0, 15, *b"loopcal virtual"]
    wire.mangle = lambda number, reply: frame(*body) if wire.requests[-1][1] == 43 else reply
    (status,) = make_link(wire, adc(), start=False).check()
    assert (status.identity, status.virtual) == ("loopcal virtual", True)


def test_a_closed_link_says_so(clock, adc):
    link = ModbusLink(PORT, [adc()], clock, Wire(Adc()).connect)
    for use in (link.check, lambda: link.pump(0.0), lambda: link.start(HZ)):
        with pytest.raises(LinkClosed, match=r"open\(\)"):
            use()
    link.close()
