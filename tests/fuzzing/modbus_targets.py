"""What comes over Modbus lines."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress

from pymodbus.framer import FramerRTU

from drivers.errors import Malformed
from drivers.modbus.mbap import AduBuffer
from drivers.modbus.pdu import READ_INPUT, Identify, Read, Verdict, read_reply
from drivers.modbus.rtu import replies
from tests.fuzzing.target import Target

REQUEST = Read(unit=3, function=READ_INPUT, address=0, count=4)
REGISTERS = (1, 0x8000, 0xFFFF, 1234)


def _framed(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def _rtu() -> Sequence[bytes]:
    reply = _framed(bytes([3, READ_INPUT, 8]) + struct.pack(">4H", *REGISTERS))
    named = bytes([3, 43, 14, 1, 1, 0, 0, 2, 0, 3]) + b"abc" + bytes([1, 2]) + b"de"
    return [reply, _framed(bytes([3, READ_INPUT | 0x80, 2])), _framed(named), reply + reply]


def _check_rtu(data: bytes) -> None:
    for request in (REQUEST, Identify(3)):
        with suppress(Malformed):
            for reply in replies(data, request):
                if reply.verdict is Verdict.ANSWER and request is REQUEST:
                    assert len(reply.registers) == REQUEST.count
                assert reply.exception_text


def _check_tcp(data: bytes) -> None:
    """Frames do not depend on how the stream is cut; each is a reply, or refused."""
    data = data[:3000]
    whole, bits = AduBuffer(), AduBuffer()
    with suppress(Malformed):
        frames = whole.feed(data)
        assert frames == [frame for byte in data for frame in bits.feed(bytes([byte]))]
        for frame in frames:
            for request in (REQUEST, Identify(3)):
                with suppress(Malformed):
                    reply = read_reply(frame.pdu, request)
                    if reply.verdict is Verdict.ANSWER and request is REQUEST:
                        assert len(reply.registers) == REQUEST.count


def _tcp() -> Sequence[bytes]:
    pdus = [frame[1:-2] for frame in _rtu()]
    return [
        b"".join(struct.pack(">HHHB", n, 0, 1 + len(pdu), 3) + pdu for n, pdu in enumerate(pdus))
    ]


def _check_rtu_flips(data: bytes, other: bytes) -> None:
    """CRC-16 notices up to three turned bits in a frame so short: rejected, or what was sent."""
    with suppress(Malformed):
        for reply in replies(other, REQUEST):
            if reply.verdict is Verdict.ANSWER:
                assert reply.registers == REGISTERS


TARGETS: tuple[Target, ...] = (
    Target("modbus-rtu", _rtu, _check_rtu, (b"\x03\x04\x08",), check_flips=_check_rtu_flips),
    Target("modbus-tcp", _tcp, _check_tcp, (b"\0\0\0\x0b\x03\x04\x08",)),
)
