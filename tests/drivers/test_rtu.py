"""Modbus RTU frames: bytes pinned from published examples, replies found in what surrounds them."""

from __future__ import annotations

import pytest
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU

from drivers.modbus.pdu import Identify, Read, Verdict
from drivers.modbus.rtu import complete_but_damaged, encode, replies

# Published worked examples (simplymodbus.ca, functions 03 and 04): unit 17.
HOLDING = Read(17, 3, 0x006B, 3)
HOLDING_FRAME = bytes.fromhex("11 03 00 6B 00 03 76 87")
HOLDING_REPLY = bytes.fromhex("11 03 06 AE 41 56 52 43 40 49 AD")
INPUT = Read(17, 4, 0x0008, 1)
INPUT_FRAME = bytes.fromhex("11 04 00 08 00 01 B2 98")
INPUT_REPLY = bytes.fromhex("11 04 02 00 0A F8 F4")
REFUSAL = bytes.fromhex(
    "0A 81 02 B0 53"
)  # function 1 of unit 10, the standard's shape of a refusal


def frame(*body: int) -> bytes:
    check = FramerRTU.compute_CRC(bytes(body))
    return bytes(body) + check.to_bytes(2, "big")


def test_requests():
    assert encode(HOLDING) == HOLDING_FRAME
    assert encode(INPUT) == INPUT_FRAME
    assert encode(Identify(1)) == bytes.fromhex("01 2B 0E 01 00 70 77")


def test_a_third_party_server_understands_the_requests():
    used, pdu = FramerRTU(DecodePDU(True)).handleFrame(encode(HOLDING), 17, 0)
    assert (used, pdu.function_code, pdu.address, pdu.count) == (8, 3, 0x6B, 3)


def test_replies():
    (reply,) = replies(HOLDING_REPLY, HOLDING)
    assert reply.verdict is Verdict.ANSWER
    assert reply.registers == (0xAE41, 0x5652, 0x4340)
    (reply,) = replies(INPUT_REPLY, INPUT)
    assert reply.registers == (10,)


def test_a_refusal():
    (reply,) = replies(REFUSAL, Read(10, 1, 0, 1))
    assert reply.verdict is Verdict.REFUSAL
    assert reply.exception_text == "Modbus exception 2 (illegal address)"
    (reply,) = replies(frame(17, 0x84, 99), INPUT)
    assert reply.exception_text == "Modbus exception 99 (unknown)"


@pytest.mark.parametrize("length", range(len(HOLDING_REPLY)))
def test_no_part_of_a_reply_is_a_reply(length: int):
    assert list(replies(HOLDING_REPLY[:length], HOLDING)) == []


@pytest.mark.parametrize("bit", range(8 * len(HOLDING_REPLY)))
def test_a_reply_with_one_wrong_bit_is_none(bit: int):
    damaged = bytearray(HOLDING_REPLY)
    damaged[bit // 8] ^= 1 << bit % 8
    assert not [r for r in replies(bytes(damaged), HOLDING) if r.verdict is Verdict.ANSWER]


@pytest.mark.parametrize(
    "before",
    [
        b"\0",
        b"\x11",
        b"\x11\x03",
        b"\x11\x03\xff",
        HOLDING_FRAME,  # the echo of a two-wire adapter
        frame(18, 3, 6, 1, 2, 3, 4, 5, 6),  # another unit's reply
        INPUT_REPLY,  # another function's reply
    ],
)
def test_a_reply_is_found_behind_noise_echoes_and_foreign_frames(before: bytes):
    (reply,) = replies(before + HOLDING_REPLY + b"\x55", HOLDING)
    assert reply.registers == (0xAE41, 0x5652, 0x4340)


def test_a_reply_of_another_length_is_late_and_the_right_one_follows():
    late, answer = replies(frame(17, 3, 2, 9, 9) + HOLDING_REPLY, HOLDING)
    assert late.verdict is Verdict.LATE
    assert answer.verdict is Verdict.ANSWER


def test_a_foreign_unit_or_function_is_no_reply():
    assert list(replies(HOLDING_REPLY, Read(18, 3, 0x6B, 3))) == []
    assert list(replies(HOLDING_REPLY, Read(17, 4, 0x6B, 3))) == []


def test_damage_is_told_from_an_unfinished_reply():
    assert not complete_but_damaged(HOLDING_REPLY, HOLDING)
    assert not complete_but_damaged(HOLDING_REPLY[:-1], HOLDING)
    assert not complete_but_damaged(b"", HOLDING)
    assert complete_but_damaged(HOLDING_REPLY[:-1] + b"\0", HOLDING)


def test_identification():
    texts = [b"loopcal virtual", b"modbus-adc", b"1.0"]
    body = [1, 43, 14, 1, 0x81, 0, 0, 3]
    for number, text in enumerate(texts):
        body += [number, len(text), *text]
    data = frame(*body)
    for length in range(len(data)):
        assert list(replies(data[:length], Identify(1))) == []
    (reply,) = replies(data, Identify(1))
    assert reply.texts == ("loopcal virtual", "modbus-adc", "1.0")
