"""Signals of a DBC file: raw values as cantools reads them, on random frames of random layouts."""

from __future__ import annotations

import random
from pathlib import Path

import cantools
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion

from drivers.can_bus import EXTENDED
from drivers.dbc.database import DbcFile
from drivers.dbc.layout import SignalLayout
from drivers.errors import Malformed, OptionError

TEXT = (Path(__file__).parent / "bench.dbc").read_text("utf-8")


@pytest.fixture(scope="module")
def dbc() -> DbcFile:
    return DbcFile(TEXT, "bench.dbc")


def random_signal(rng: random.Random, size: int) -> Signal:
    length = rng.randint(1, 8 * size)
    little = rng.random() < 0.5
    first = rng.randint(0, 8 * size - length)  # bits in front of it, in its own order
    start = first if little else 8 * (first // 8) + 7 - first % 8
    return Signal(
        "x",
        start,
        length,
        byte_order="little_endian" if little else "big_endian",
        is_signed=rng.random() < 0.5,
        conversion=BaseConversion.factory(scale=rng.uniform(0.1, 9.0), offset=rng.uniform(-9, 9)),
    )


def test_cantools_reads_the_same_raw_values_from_random_frames():
    rng = random.Random(5)
    for _ in range(1500):
        size = rng.randint(1, 8)
        signal = random_signal(rng, size)
        message = Message(0x100, "m", size, [signal])
        layout = SignalLayout(
            "x", signal.start, signal.length, signal.byte_order == "little_endian", signal.is_signed
        )
        data = rng.randbytes(size)
        raw = message.decode(data, decode_choices=False, scaling=False)["x"]
        assert layout.raw(data) == raw, (signal, data.hex())
        put = layout.put(raw, bytes(size))
        assert put == message.encode({"x": raw}, scaling=False, padding=False)
        assert layout.put(raw, data) == data


def test_cantools_agrees_on_multiplexed_frames(dbc):
    theirs = cantools.database.load_string(TEXT, "dbc").get_message_by_name("Multiplexed")
    ours = dbc.message("Multiplexed")
    assert ours.identifier == theirs.frame_id | EXTENDED
    rng = random.Random(6)
    for _ in range(200):
        data = bytes([rng.randint(0, 1)]) + rng.randbytes(7)
        decoded = theirs.decode(data, decode_choices=False, scaling=False)
        for name in ("Page", "Wrist", "Finger"):
            assert ours.signal(name).raw(data) == decoded.get(name)


def test_values_at_the_ends_of_a_signal():
    layout = SignalLayout("x", 4, 12, True, True)
    assert layout.limits == (-2048, 2047)
    for value in (-2048, -1, 0, 2047):
        assert layout.raw(layout.put(value, b"\xff\xff\xff")) == value
    with pytest.raises(ValueError, match="x is 2048, expected -2048 to 2047"):
        layout.put(2048, bytes(2))


@pytest.mark.parametrize("little", [True, False])
def test_a_frame_that_is_too_short_is_malformed(little):
    layout = SignalLayout("x", 8 if little else 15, 16, little, False)
    with pytest.raises(Malformed, match="2 bytes, but the signal x ends at bit 23"):
        layout.raw(b"\1\2")


def test_cycle_times_come_from_the_file(dbc):
    assert dbc.message("ElbowPosition").period_ns == 10_000_000
    assert dbc.message("Multiplexed").period_ns is None


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("ElbowPositon.Angle", "no message 'ElbowPositon'.*ElbowPosition"),
        ("ElbowPosition.Angel", "no signal 'Angel'; it has: Angle, Temperature"),
        ("Count", "in ElbowPosition, DriveCommand; write"),
        ("Nothing", "in no message"),
    ],
)
def test_names_that_are_not_there(dbc, reference, words):
    with pytest.raises(OptionError, match=words):
        dbc.find(reference)


def test_a_signal_of_one_message_needs_no_more_than_its_name(dbc):
    message, name = dbc.find("Angle")
    assert (message.name, name) == ("ElbowPosition", "Angle")


def test_a_floating_point_signal_has_no_counts(dbc):
    with pytest.raises(OptionError, match="floating-point"):
        dbc.find("Floating.Value")


@pytest.mark.parametrize("text", ["", "not a database"])
def test_what_is_no_dbc_file(text):
    with pytest.raises(OptionError, match=r"file of device 'e1'.* (not a DBC|has no message)"):
        DbcFile(text, "the file of device 'e1'").message("X")
