"""The streaming converters' encodings, judged by third parties, and their time."""

from __future__ import annotations

import struct

import pytest
from cobs import cobs
from crccheck import crc as theirs
from hypothesis import given
from hypothesis import strategies as st

from sim_devices.crystal import Crystal
from sim_devices.streams import (
    CRCS,
    PacketFormat,
    StreamAdc,
    StreamSample,
    StreamText,
    crc16,
    line_of,
    stuffed,
)


@given(st.binary(max_size=600))
def test_the_cobs_package_unstuffs_and_stuffs_alike(packet: bytes) -> None:
    assert stuffed(packet) == cobs.encode(packet)
    assert cobs.decode(stuffed(packet)) == packet


@pytest.mark.parametrize(
    ("name", "judge"),
    [
        ("ccitt-false", theirs.Crc16Ibm3740),
        ("xmodem", theirs.Crc16Xmodem),
        ("modbus", theirs.Crc16Modbus),
        ("arc", theirs.Crc16Arc),
    ],
)
@given(data=st.binary(max_size=40))
def test_crccheck_computes_the_same(name: str, judge, data: bytes) -> None:
    assert crc16(data, *CRCS[name]) == judge.calc(data)


def test_a_packet_byte_by_byte() -> None:
    fields = [("kind", 8, 1), ("sequence", 16, None), ("time", 32, None), ("x", 32, None)]
    made = PacketFormat(fields, CRCS["modbus"], "big", 1000).encode(
        StreamSample(65_537, 12_345_678.9, {"x": -2})
    )
    packet = cobs.decode(made[:-1])
    assert packet[:-2] == struct.pack(">BHIi", 1, 1, 12_345, -2)
    assert packet[-2:] == theirs.Crc16Modbus.calc(packet[:-2]).to_bytes(2, "big")


def test_lines() -> None:
    sample = StreamSample(70_000, 1500.7, {"x": -5, "y": 123})
    widths = {"sequence": 16, "time": 32}
    assert line_of("{sequence};{time}: {x} {y} {-}", 1.0, 1, widths)(sample) == (
        b"4464;1500: -5 123 0\r\n"
    )
    assert line_of("{x},{y}", 0.01, 1, widths)(sample) == b"-0.05,1.23\r\n"


@pytest.fixture
def adc(plant) -> StreamAdc:
    plant.counts = {"q1": 7}
    return StreamAdc(
        100.0, {"x": "q1"}, plant, lambda sample: b"%d;" % sample.number, Crystal(0.01)
    )


def test_samples_come_at_the_rate_of_its_crystal(adc: StreamAdc) -> None:
    assert adc.tick(0.0) == b"0;"
    assert adc.tick(0.0099) == b""
    assert adc.tick(0.0100) == b"1;"  # it runs 1 % fast
    assert adc.tick(0.05) == b"2;3;4;5;"
    assert adc.tick(100.0).count(b";") == 1000  # what it was held up for longer it has lost


def test_it_sends_between_its_start_and_stop_texts(plant) -> None:
    text = StreamText(b"go\n", b"halt\n")
    adc = StreamAdc(100.0, {}, plant, lambda s: b"%d;" % s.number, Crystal(), text)
    assert adc.tick(0.0) == b""
    adc.receive(b"noise g", 0.0)
    adc.receive(b"o\n", 0.0)
    assert adc.tick(0.02) == b"1;2;"
    adc.receive(b"halt\n", 0.02)
    assert adc.tick(0.03) == b""
    adc.receive(b"go\n", 0.03)
    assert adc.tick(0.04) == b"4;"
