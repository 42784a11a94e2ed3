"""The register map of the virtual converter."""

from __future__ import annotations

import pytest

from sim_devices.modbus import ExceptionCode, RequestRefused
from sim_devices.modbus_adc import AdcLayout, AdcRegisters, Cell


@pytest.fixture
def registers(plant) -> AdcRegisters:
    plant.counts = {"q6": 2048, "q7": -2}
    return AdcRegisters(AdcLayout.in_a_row(3, 1, 0), {0: "q6", 1: "q7"}, plant)


def test_one_read_gives_all(registers: AdcRegisters) -> None:
    # Counter, two counts (one of them negative), the open input, 7.0 s as 70,000 = 0x00011170.
    assert registers.read_input(0, 6, 7.0) == [1, 2048, 0xFFFE, 0, 0x0001, 0x1170]
    assert registers.read_input(0, 1, 7.0) == [2]
    assert registers.read_holding(0, 2, 7.0) == [3, 2048]


def test_counter_wraps(registers: AdcRegisters) -> None:
    for _ in range(0xFFFF):
        last = registers.read_input(0, 1, 0.0)
    assert last == [0xFFFF]
    assert registers.read_input(0, 1, 0.0) == [0]


@pytest.mark.parametrize(
    ("address", "count"), [(0, 7), (6, 1), (0xEFFF, 2), (0xF000, 1), (1000, 1)]
)
def test_input_registers_end(registers: AdcRegisters, address: int, count: int) -> None:
    with pytest.raises(RequestRefused) as caught:
        registers.read_input(address, count, 0.0)
    assert caught.value.code is ExceptionCode.ILLEGAL_DATA_ADDRESS


def test_refused_read_takes_no_sample(registers: AdcRegisters) -> None:
    with pytest.raises(RequestRefused):
        registers.read_input(0, 50, 0.0)
    registers.read_holding(0xF000, 2, 0.0)
    assert registers.read_input(0, 1, 0.0) == [1]


def test_settings(registers: AdcRegisters, plant, monkeypatch: pytest.MonkeyPatch) -> None:
    registers.write_holding(0xF000, [4, 99])
    assert registers.read_holding(0xF000, 2, 0.0) == [4, 99]
    noisy = iter([10, 12, 13, 13])
    monkeypatch.setattr(plant, "sense", lambda channel: next(noisy) if channel == "q6" else 0)
    assert registers.read_input(1, 1, 0.0) == [12]


@pytest.mark.parametrize(
    ("address", "values", "code"),
    [
        (0xF000, [0, 5], ExceptionCode.ILLEGAL_DATA_VALUE),
        (0xF000, [65], ExceptionCode.ILLEGAL_DATA_VALUE),
        (1, [5], ExceptionCode.ILLEGAL_DATA_ADDRESS),
        (0xF001, [5, 5], ExceptionCode.ILLEGAL_DATA_ADDRESS),
    ],
)
def test_refused_write_changes_nothing(registers, address, values, code) -> None:
    with pytest.raises(RequestRefused) as caught:
        registers.write_holding(address, values)
    assert caught.value.code is code
    assert registers.read_holding(0xF000, 2, 0.0) == [1, 0]


@pytest.mark.parametrize(
    ("layout", "fits"),
    [
        (AdcLayout.in_a_row(2, 1, 0), True),
        (AdcLayout.in_a_row(2, 0), True),
        (AdcLayout.in_a_row(2, 0, 4), True),
        (AdcLayout.in_a_row(2, 0, 3), False),
        (AdcLayout.in_a_row(2, 10, 9), True),
        (AdcLayout.in_a_row(2, 0xEFFC), True),
        (AdcLayout.in_a_row(2, 0xEFFD), False),
        (AdcLayout.in_a_row(2, 0, 0xF000), False),
    ],
)
def test_layout_collides_or_not(layout: AdcLayout, fits: bool) -> None:
    assert layout.fits == fits


def test_converter_without_a_counter(plant) -> None:
    plant.counts = {"q6": 5}
    registers = AdcRegisters(AdcLayout.in_a_row(1, 0), {0: "q6"}, plant)
    assert registers.read_input(0, 3, 1.0) == [5, 0, 10_000]


@pytest.mark.parametrize(
    ("cell", "value", "words"),
    [
        (Cell(0, "int16"), -2, [0xFFFE]),
        (Cell(0, "uint16", "BADC"), 0x0102, [0x0201]),
        (Cell(0, "uint32", "ABCD"), 0x01020304, [0x0102, 0x0304]),
        (Cell(0, "uint32", "CDAB"), 0x01020304, [0x0304, 0x0102]),
        (Cell(0, "uint32", "BADC"), 0x01020304, [0x0201, 0x0403]),
        (Cell(0, "uint32", "DCBA"), 0x01020304, [0x0403, 0x0201]),
        (Cell(0, "int32", "CDAB"), -70_000, [0xEE90, 0xFFFE]),
        (Cell(0, "float32"), 1.5, [0x3FC0, 0x0000]),
    ],
)
def test_numbers_of_every_type_and_order(cell: Cell, value: float, words: list[int]) -> None:
    assert cell.words(value) == words


def test_a_map_with_holes(plant) -> None:
    plant.counts = {"q6": -5}
    layout = AdcLayout(
        signals={"x": Cell(10, "int32", "CDAB")}, time=Cell(14, "uint16"), ticks_per_s=1000
    )
    registers = AdcRegisters(layout, {"x": "q6"}, plant)
    assert registers.read_input(10, 5, 0.25) == [0xFFFB, 0xFFFF, 0, 0, 250]
