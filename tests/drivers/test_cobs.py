"""COBS: published vectors, and the ``cobs`` package on random packets. CRC-16: the catalogue's checks."""

from __future__ import annotations

import pytest
from cobs import cobs as theirs
from hypothesis import given
from hypothesis import strategies as st

from drivers.stream.cobs import PacketBuffer, decode
from drivers.stream.crc import CRCS

ASCENDING = bytes(range(1, 256))

# Packet and encoding. First: Cheshire & Baker 1999, figure 3. Others: the table of examples in
# Wikipedia, "Consistent Overhead Byte Stuffing", without the delimiter.
PUBLISHED = [
    ("45 00 00 2C 4C 79 00 00 40 06 4F 37", "02 45 01 04 2C 4C 79 01 05 40 06 4F 37"),
    ("00", "01 01"),
    ("00 00", "01 01 01"),
    ("00 11 00", "01 02 11 01"),
    ("11 22 00 33", "03 11 22 02 33"),
    ("11 22 33 44", "05 11 22 33 44"),
    ("11 00 00 00", "02 11 01 01 01"),
    (ASCENDING[:254].hex(), "FF" + ASCENDING[:254].hex()),
    ("00" + ASCENDING[:254].hex(), "01FF" + ASCENDING[:254].hex()),
    (ASCENDING.hex(), "FF" + ASCENDING[:254].hex() + "02FF"),
    (ASCENDING[1:].hex() + "00", "FF" + ASCENDING[1:].hex() + "0101"),
    (ASCENDING[2:].hex() + "0001", "FE" + ASCENDING[2:].hex() + "0201"),
]


@pytest.mark.parametrize(("packet", "encoded"), PUBLISHED)
def test_published_packets(packet, encoded):
    assert decode(bytes.fromhex(encoded)) == bytes.fromhex(packet)


@given(st.binary(max_size=600))
def test_the_cobs_package_encodes_what_is_decoded_here(packet):
    assert decode(theirs.encode(packet)) == packet


@given(st.binary(max_size=20).filter(lambda data: 0 not in data))
def test_the_cobs_package_refuses_what_is_refused_here(encoded):
    try:
        expected = theirs.decode(encoded)
    except theirs.DecodeError:
        with pytest.raises(ValueError, match="COBS packet"):
            decode(encoded)
    else:
        assert decode(encoded) == expected


@given(
    packets=st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=6),
    sizes=st.lists(st.integers(1, 30)),
)
def test_packets_are_whole_however_they_arrive(packets, sizes):
    stream = b"\0" + b"".join(theirs.encode(packet) + b"\0" for packet in packets)
    buffer, came, at = PacketBuffer(64), [], 0
    for size in [*sizes, len(stream)]:
        came += buffer.feed(stream[at : at + size])
        at += size
    assert [decode(each) for each in came] == packets


def test_a_stream_joined_in_the_middle_is_in_step_after_the_next_zero():
    buffer = PacketBuffer(64)
    assert buffer.feed(b"\x22\x33\0" + theirs.encode(b"one") + b"\0") == [theirs.encode(b"one")]
    buffer.reset()
    assert buffer.feed(b"\x33\0\0\0") == []


def test_babble_without_a_delimiter_does_not_pile_up():
    buffer = PacketBuffer(64)
    buffer.feed(b"\0")
    cut = [each for _ in range(100) for each in buffer.feed(b"x" * 20)]
    assert len(cut) == 1
    assert buffer.feed(b"x\0" + theirs.encode(b"two") + b"\0") == [theirs.encode(b"two")]


@pytest.mark.parametrize(
    ("name", "check"),
    [("ccitt-false", 0x29B1), ("xmodem", 0x31C3), ("modbus", 0x4B37), ("arc", 0xBB3D)],
)
def test_checks_of_the_catalogue(name, check):
    assert CRCS[name].of(b"123456789") == check
