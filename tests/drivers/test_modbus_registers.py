"""Numbers in registers, in every order of bytes, and readings made of them."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.modbus.adc import AdcOptions, RegisterMap
from drivers.modbus.registers import Register
from recordings.events import ReadingFlag


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ("ABCD", (0x0102, 0x0304)),
        ("CDAB", (0x0304, 0x0102)),
        ("BADC", (0x0201, 0x0403)),
        ("DCBA", (0x0403, 0x0201)),
    ],
)
def test_orders_of_the_field(order, words):
    """The same number 0x01020304 as devices of the four kinds send it."""
    assert Register(0, "uint32", order).integer(words) == 0x01020304
    assert (
        Register(0, "uint16", order).integer(words[:1])
        == {
            "ABCD": 0x0102,
            "CDAB": 0x0304,
            "BADC": 0x0102,
            "DCBA": 0x0304,
        }[order]
    )


@given(value=st.integers(-(1 << 31), (1 << 31) - 1))
def test_signed_numbers_as_struct_packs_them(value):
    high, low = struct.unpack(">HH", struct.pack(">i", value))
    assert Register(0, "int32", "ABCD").integer((high, low)) == value
    assert Register(0, "int32", "CDAB").integer((low, high)) == value


@pytest.mark.parametrize(("value", "counts"), [(1.25, 1250), (-0.0004, 0), (float("nan"), None)])
def test_a_float_is_counted_in_its_resolution(value, counts):
    words = struct.unpack(">HH", struct.pack(">f", value))
    assert Register(0, "float32").counts(words, 0.001) == counts


MAP = {
    "unit_id": 1,
    "signals": {
        "force": {"address": 10, "type": "int32", "order": "CDAB"},
        "gap": {"address": 14, "type": "float32"},
    },
    "resolution": 1e-3,
    "counter_register": 12,
    "counter_counts": "reads",
    "time_register": 16,
    "time_type": "uint16",
    "time_tick_us": 1000,
}


@pytest.fixture
def register_map(channel) -> RegisterMap:
    return RegisterMap(
        AdcOptions.model_validate(MAP), [channel("q1", "force"), channel("q2", "gap")]
    )


def registers(count: int, time_ms: int, gap: float = 0.5) -> list[int]:
    return [0xFFFE, 0xFFFF, count, 0, *struct.unpack(">HH", struct.pack(">f", gap)), time_ms]


def test_one_read_covers_the_whole_map():
    options = AdcOptions.model_validate(MAP)
    assert (options.address, options.count) == (10, 7)


def test_signals_counter_and_device_time(register_map):
    (first, second), missed, restarted = register_map.readings(registers(65535, 65530), 0)
    assert (first.raw, second.raw) == (-2, 500)
    assert (missed, restarted) == (0, False)
    (first, _), missed, restarted = register_map.readings(registers(2, 4), 10_000_000)
    assert (first.sequence, first.device_time_ns) == (65538, 65_540_000_000)
    assert (missed, restarted) == (2, False)


def test_a_clock_that_goes_back_is_a_restart(register_map):
    register_map.readings(registers(500, 9000), 0)
    (reading, _), missed, restarted = register_map.readings(registers(1, 5), 10_000_000)
    assert (reading.sequence, reading.device_time_ns) == (1, 5_000_000)
    assert (missed, restarted) == (0, True)


def test_what_is_no_number_is_flagged(register_map):
    (force, gap), _, _ = register_map.readings(registers(1, 1, float("inf")), 0)
    assert (force.flags, gap.flags) == (ReadingFlag.NONE, ReadingFlag.DEVICE_ERROR)


@pytest.mark.parametrize("counts", ["reads", "conversions"])
def test_a_counter_alone_tells_a_restart_only_where_it_counts_reads(channel, counts):
    options = {"unit_id": 1, "first_register": 1, "channels": 1, "counter_register": 0}
    options["counter_counts"] = counts
    table = RegisterMap(AdcOptions.model_validate(options), [channel("q1", 0)])
    table.readings([20_000, 7], 0)
    (reading,), missed, restarted = table.readings([3, 7], 10_000_000)
    assert missed == 0
    assert restarted == (counts == "reads")
    assert reading.sequence == (3 if restarted else 65536 + 3)
