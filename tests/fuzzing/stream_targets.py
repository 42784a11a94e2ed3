"""What converters stream unasked: COBS packets, and lines of text."""

from __future__ import annotations

import struct

from drivers.stream.ascii_adc import AsciiAdcOptions, LineDecoder
from drivers.stream.cobs import decode
from drivers.stream.cobs_adc import CobsAdcOptions, PacketDecoder
from drivers.stream.crc import CRCS
from drivers.stream.decoder import Decoder, Sample
from tests.fuzzing.target import Target

FIELDS = ["kind:u8=7", "sequence:u16", "time:u32", "flags:u8", "volts:i32"]
PATTERN = "{sequence} {time} a={left}, b={right}"


def _stuffed(packet: bytes) -> bytes:
    """COBS for packets of fewer than 254 bytes, written anew for the test, with its delimiter."""
    return b"".join(bytes([len(part) + 1]) + part for part in packet.split(b"\0")) + b"\0"


def _packets() -> list[bytes]:
    bodies = [
        struct.pack("<BHIBi", 7, n, 1000 * n, n % 8, value)
        for n, value in enumerate((0, 1, -1, 2**31 - 1, -(2**31), 1234))
    ]
    whole = [body + CRCS["ccitt-false"].of(body).to_bytes(2, "little") for body in bodies]
    return [b"\0" + b"".join(map(_stuffed, whole)), *map(_stuffed, whole)]


def _packet_decoder() -> PacketDecoder:
    return PacketDecoder(CobsAdcOptions.model_validate({"fields": FIELDS}))


def _line_decoder() -> LineDecoder:
    return LineDecoder(AsciiAdcOptions.model_validate({"pattern": PATTERN}))


def _check(decoder: Decoder, again: Decoder, data: bytes, longest: int) -> None:
    """No error gets out, numbers fit their fields, and how the bytes are cut does not matter."""
    data = data[:3000]
    found = list(decoder.feed(data))
    for each in found:
        if isinstance(each, Sample):
            for count in each.counts.values():
                assert count is None or abs(count) <= 2**53
            assert each.sequence is None or 0 <= each.sequence < 2**32
            assert each.ticks is None or 0 <= each.ticks < 2**32
    if all(
        len(part) <= longest
        for part in data.replace(b"\n", b"\0").replace(b"\r", b"\0").split(b"\0")
    ):
        assert found == [each for byte in data for each in again.feed(bytes([byte]))]


def _check_packets(data: bytes) -> None:
    _check(_packet_decoder(), _packet_decoder(), data, 200)
    for part in data.split(b"\0"):
        try:
            packet = decode(part)
        except ValueError:
            continue
        if part and len(packet) < 250:
            assert _stuffed(packet)[:-1] == part, "two ways to write one packet"


def _check_lines(data: bytes) -> None:
    _check(_line_decoder(), _line_decoder(), data, 100)


TARGETS: tuple[Target, ...] = (
    Target("cobs", _packets, _check_packets, (b"\0", b"\xff", b"\x01")),
    Target(
        "ascii-lines",
        lambda: [b"\n1 1000 a=5, b=-6\n2 2000 a=+7.0, b=1e3\n# note\n3 3000 a=0, b=9\n"],
        _check_lines,
        (b"\n", b"\r", b"1e999", b"nan", b"inf", b"a=", b"#"),
        text=True,
    ),
)
