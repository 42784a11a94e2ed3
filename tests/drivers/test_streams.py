"""Streaming sensors: packets and lines to readings, exact losses, restarts, silence, a port that goes."""

from __future__ import annotations

import struct
from collections import deque

import pytest
from cobs import cobs as theirs
from crccheck.crc import Crc16Ibm3740
from hypothesis import given
from hypothesis import strategies as st

from drivers.driver import DeviceSpec
from drivers.errors import LinkClosed, OptionError, PortNotFound
from drivers.link import Losses
from drivers.stream import ascii_adc, cobs_adc
from drivers.stream.ascii_adc import AsciiAdcOptions, LineDecoder
from drivers.stream.cobs_adc import CobsAdcOptions
from drivers.stream.decoder import Sample
from drivers.stream.link import StreamLink
from recordings.events import Fault, Reading, ReadingFlag
from recordings.faults import FaultKind
from recordings.rig import SerialPort

PORT = SerialPort(kind="serial", name="line", path="/nowhere")
FIELDS = ["kind:u8=1", "flags:u8", "sequence:u16", "time:u32", "x:i32", "y:i16"]
PERIOD_S = 0.01


class FakePort:
    """A serial port that gives what a test pushes."""

    def __init__(self) -> None:
        self.incoming: deque[bytes] = deque()
        self.sent = b""
        self.plugged = True

    def connect(self, _port: SerialPort) -> FakePort:
        if not self.plugged:
            raise FileNotFoundError(2, "No such file or directory")
        return self

    def read(self, timeout_s: float | None) -> bytes:
        if not self.plugged:
            raise OSError(5, "Input/output error")
        return self.incoming.popleft() if self.incoming else b""

    def write(self, data: bytes) -> None:
        if not self.plugged:
            raise OSError(5, "Input/output error")
        self.sent += data

    def close(self) -> None:
        pass


@pytest.fixture
def port() -> FakePort:
    return FakePort()


@pytest.fixture
def make(port, clock, channel):
    links = []

    def make(module, kind, signals=("x", "y"), start=True, **options) -> StreamLink:
        channels = tuple(channel(f"q-{name}", name) for name in signals)
        spec = DeviceSpec("adc", "adc", "line", None, channels, kind.model_validate(options))
        link = StreamLink(PORT, [module.make(spec)], clock, port.connect)
        links.append(link)
        link.open()
        if start:
            link.start(100.0)
        return link

    yield make
    for link in links:
        link.close()


@pytest.fixture
def binary(make, port):
    def make_binary(**options) -> StreamLink:
        link = make(cobs_adc, CobsAdcOptions, **{"fields": FIELDS, "sample_hz": 100.0, **options})
        port.incoming.append(b"\0")
        link.pump(0.0)
        return link

    return make_binary


def packet(sequence: int, time_us: int, x: int = 1, y: int = 2, flags: int = 0, kind: int = 1):
    body = struct.pack("<BBHIih", kind, flags, sequence % 65536, time_us % (1 << 32), x, y)
    crc = Crc16Ibm3740.calc(body)  # CRC-16/CCITT-FALSE of a third party
    return theirs.encode(body + struct.pack("<H", crc)) + b"\0"


def test_packets_become_readings(binary, port, clock):
    link = binary()
    port.incoming.append(packet(65535, (1 << 32) - 5000, -70_000, -3) + packet(0, 5000, 8, 9, 1))
    events = link.pump(0.0)
    assert [(e.channel, e.raw) for e in events] == [
        ("q-x", -70_000), ("q-y", -3), ("q-x", 8), ("q-y", 9),
    ]  # fmt: skip
    first, last = events[0], events[-1]
    assert (first.sequence, last.sequence) == (65535, 65536)
    assert last.device_time_ns - first.device_time_ns == 10_000_000
    assert (first.flags, last.flags) == (ReadingFlag.NONE, ReadingFlag.OVERRANGE)
    link.stop()
    assert link.losses() == {"q-x": Losses(2, 0, 0, 0), "q-y": Losses(2, 0, 0, 0)}


@pytest.mark.parametrize("lost", [1, 2, 65_535, 65_536, 200_000])
def test_losses_are_exact_also_over_wraps_of_the_sequence(binary, port, clock, lost):
    link = binary()
    port.incoming.append(packet(65_500, 0))
    link.pump(0.0)
    clock.advance(PERIOD_S * (lost + 1))
    port.incoming.append(packet(65_500 + lost + 1, round(1e6 * PERIOD_S * (lost + 1))))
    events = link.pump(0.0)
    assert [e.sequence for e in events if isinstance(e, Reading)] == [65_500 + lost + 1] * 2
    assert link.losses()["q-x"] == Losses(lost + 2, 0, lost, 1)


def test_a_damaged_packet_is_malformed_and_one_loss(binary, port, clock):
    link = binary()
    damaged = bytearray(packet(2, 20_000))
    damaged[9] ^= 0x10
    port.incoming.append(packet(1, 10_000) + bytes(damaged) + packet(3, 30_000))
    events = link.pump(0.0)
    assert [e.kind for e in events if isinstance(e, Fault)] == [FaultKind.MALFORMED]
    assert [e.sequence for e in events if isinstance(e, Reading)] == [1, 1, 3, 3]
    assert link.losses()["q-x"] == Losses(3, 0, 1, 1)


@given(at=st.integers(0, 15), bit=st.integers(0, 7))
def test_no_single_bit_error_gives_a_wrong_reading(at, bit):
    decoder = cobs_adc.PacketDecoder(CobsAdcOptions.model_validate({"fields": FIELDS}))
    decoder.feed(b"\0")
    good = packet(7, 12_345, 1000, -1)
    (expected,) = decoder.feed(good)
    bad = bytearray(good)
    bad[at % len(bad)] ^= 1 << bit
    for item in decoder.feed(bytes(bad) + b"\0" + good):
        assert isinstance(item, str) or item == expected


def test_packets_of_other_kinds_are_passed_over(binary, port):
    link = binary()
    other = b"\2hello"
    crc = struct.pack("<H", Crc16Ibm3740.calc(other))
    port.incoming.append(packet(1, 0, kind=2) + theirs.encode(other + crc) + b"\0" + packet(2, 9))
    assert [e.sequence for e in link.pump(0.0)] == [2, 2]


def test_a_restart_is_told_and_is_no_loss_of_its_counter(binary, port, clock):
    link = binary()
    port.incoming.append(packet(900, 9_000_000))
    link.pump(0.0)
    clock.advance(3 * PERIOD_S)
    port.incoming.append(packet(0, 50))
    fault, first, _ = link.pump(0.0)
    assert (fault.source, fault.kind) == ("adc", FaultKind.RESTARTED)
    assert (first.sequence, first.device_time_ns) == (0, 50_000)
    assert link.losses()["q-x"] == Losses(4, 2, 0, 0)  # by the rate: 3 periods, 1 came


def test_the_same_packet_again_is_stale(binary, port):
    link = binary()
    port.incoming.append(packet(5, 50) * 2)
    assert [e.flags for e in link.pump(0.0)[::2]] == [ReadingFlag.NONE, ReadingFlag.STALE]


def test_silence_is_reported_once_counted_and_ended(binary, port, clock):
    link = binary()
    port.incoming.append(packet(0, 0))
    link.pump(0.0)
    kinds = []
    for _ in range(100):
        clock.advance(PERIOD_S)
        kinds += [e.kind for e in link.pump(0.0)]
    assert kinds == [FaultKind.SILENT]
    assert link.losses()["q-x"] == Losses(100, 99, 0, 0)
    clock.advance(PERIOD_S)
    port.incoming.append(packet(101, 1_010_000))
    assert link.pump(0.0)[0].kind == FaultKind.ANSWERING
    assert link.losses()["q-x"] == Losses(102, 0, 100, 1)


def test_a_port_that_goes_away_costs_what_the_sequence_says(binary, port, clock):
    link = binary(start_text="go\n", stop_text="halt\n")
    port.incoming.append(packet(0, 0))
    link.pump(0.0)
    port.plugged = False
    events = list(link.pump(0.0))
    clock.advance(1.0)
    assert link.losses()["q-x"].lost_in_gaps == 99
    port.plugged = True
    port.incoming.append(b"\x55\0" + packet(105, 1_050_000))  # the end of one, then a whole one
    clock.advance(0.05)
    events += [e for _ in range(2) for e in link.pump(0.0)]
    assert [e.kind for e in events if isinstance(e, Fault)] == [
        FaultKind.BROKEN,
        FaultKind.REOPENED,
    ]
    link.stop()
    assert link.losses()["q-x"] == Losses(106, 0, 104, 1)
    assert port.sent == b"go\ngo\nhalt\n"


def test_the_check_listens_for_a_sample(make, port):
    options = {"fields": FIELDS, "timeout_s": 0.05}
    link = make(cobs_adc, CobsAdcOptions, start=False, **options)
    (status,) = link.check()
    assert not status.answers
    assert "no bytes came" in status.problem
    port.incoming += [b"\0\1\2\3\4\0", b"\1\0"]
    (status,) = link.check()
    assert "8 bytes came, 2 pieces malformed" in status.problem
    port.incoming.append(packet(1, 1))
    (status,) = link.check()
    assert (status.answers, status.channels) == (True, ("q-x", "q-y"))


def test_a_closed_link_and_a_missing_port(make, port, clock):
    link = make(cobs_adc, CobsAdcOptions, start=False, fields=FIELDS)
    link.close()
    with pytest.raises(LinkClosed):
        link.pump(0.0)
    port.plugged = False
    with pytest.raises(PortNotFound, match="/nowhere"):
        link.open()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (["x:i24"], "has 'x:i24', expected NAME:TYPE"),
        (["x:u8", "x:u8"], "has 'x' twice"),
        (["sequence:i16", "x:u8"], "expected an unsigned type"),
        (["kind:u8=1", "pad:u8"], "has no signal"),
    ],
)
def test_wrong_fields(fields, words):
    with pytest.raises(ValueError, match=words):
        CobsAdcOptions.model_validate({"fields": fields})


def test_a_signal_that_the_stream_has_not(make):
    with pytest.raises(OptionError, match="has the signals x, y"):
        make(cobs_adc, CobsAdcOptions, signals=("z",), fields=FIELDS)


# Lines of text.


def lines(pattern: str, text: str, **options) -> list:
    decoder = LineDecoder(AsciiAdcOptions.model_validate({"pattern": pattern, **options}))
    decoder.feed(b"half a line\n")
    return list(decoder.feed(text.encode("latin-1")))


@pytest.mark.parametrize(
    ("pattern", "line", "counts"),
    [
        ("{x},{y}", "12,-7", {"x": 12, "y": -7}),
        ("{x},{y}", "  12 ,\t+7  ", {"x": 12, "y": 7}),
        ("{x} {y}", "12   34", {"x": 12, "y": 34}),
        ("X={x} Y={y}", "X= 5Y=6", {"x": 5, "y": 6}),
        ("$ADC,{-},{x}", "$ADC,999,3", {"x": 3}),
        ("{x}", "9007199254740992", {"x": 2**53}),
    ],
)
def test_lines_of_the_pattern(pattern, line, counts):
    assert lines(pattern, line + "\r\n") == [Sample(counts)]


@pytest.mark.parametrize(
    "line",
    ["1234", "12;34", "12,34,56", "12,", "a,b", "12,34x", "1e400,2", "99999999999999999,1", "\xff"],
)
def test_other_lines_are_malformed(line):
    (item,) = lines("{x},{y}" if line != "1234" else "{x} {y}", line + "\n")
    assert isinstance(item, str)


def test_comments_and_empty_lines_are_passed_over():
    assert lines("{x}", "# booting\n\n\r\n5\n") == [Sample({"x": 5})]


def test_decimals_are_counted_in_the_resolution():
    assert lines("{x},{y}", "1.2345,-2e-1\n", resolution=1e-4) == [
        Sample({"x": 12_345, "y": -2000})
    ]


def test_sequence_and_time_are_taken_modulo_their_width():
    (sample,) = lines("{sequence} {time} {x}", "65537 12.4 1\n", sequence_bits=16)
    assert (sample.sequence, sample.ticks) == (1, 12)


@pytest.mark.parametrize("size", range(1, 9))
def test_lines_are_whole_however_they_arrive(size):
    decoder = LineDecoder(AsciiAdcOptions.model_validate({"pattern": "{x}"}))
    stream, came = b"4\r\n123\r\n-5\n", []
    for at in range(0, len(stream), size):
        came += decoder.feed(stream[at : at + size])
    assert came == [Sample({"x": 123}), Sample({"x": -5})]


def test_the_first_line_may_have_lost_its_beginning_and_is_not_taken():
    decoder = LineDecoder(AsciiAdcOptions.model_validate({"pattern": "{x}"}))
    assert decoder.feed(b"34\n1234\n") == [Sample({"x": 1234})]


def test_lines_without_a_counter_lose_what_the_rate_says(make, port, clock):
    link = make(ascii_adc, AsciiAdcOptions, ("x",), pattern="{x}", sample_hz=100.0)
    port.incoming.append(b"0\n")
    link.pump(0.0)
    for pause in (1, 1, 4, 1):
        clock.advance(PERIOD_S * pause)
        port.incoming.append(b"5\n")
        link.pump(0.0)
    assert link.losses()["q-x"] == Losses(7, 3, 0, 0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pattern": "1,2"}, "expected a signal in braces"),
        ({"pattern": "{x}{y}"}, "not separated"),
        ({"pattern": "{x},{x}"}, "'{x}' twice"),
        ({"pattern": "{x"}, "whose braces hold no name"),
        ({"pattern": "{x}", "resolution": 0.0}, "'resolution' is 0.0"),
        ({"pattern": "{x}", "sample_hz": 0}, "'sample_hz' is 0.0"),
    ],
)
def test_wrong_patterns(options, words):
    with pytest.raises(ValueError, match=words):
        AsciiAdcOptions.model_validate(options)
