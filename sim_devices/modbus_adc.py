"""A virtual analogue-to-digital converter: the register map behind a Modbus server.

Input registers (function 4), and the same values as holding registers (function 3); addresses,
types and orders come from the device's options in the rig:

    counter_register    sample counter; none where the option is absent
    signals             raw counts, in two's complement where a channel goes below 0; of a
                        float32, counts times the resolution
    time_register       device time since power on; where the option is absent, behind the
                        signals: uint32 [100 us], high word first

Registers between these read 0.

Holding registers (functions 3, 6, 16):

    0xF000    averaging: conversions averaged into one sample, 1..64 (1 at power on)
    0xF001    tag: a number of the user's, any value (0 at power on)

Every read that touches the first group takes one sample of all signals at once and adds one to
the counter, so registers of one read belong together, and a counter that grows by more than
one between two reads shows that an answer was lost. Signals that no channel of the rig
measures read 0. Identification (function 43/14): vendor "loopcal virtual", product
"modbus-adc", revision "1.0".
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim_devices.crystal import PERFECT, Crystal
from sim_devices.modbus import ExceptionCode, RequestRefused
from sim_devices.plant_seam import Plant

SETTINGS_START = 0xF000
AVERAGING_REGISTER = SETTINGS_START
TAG_REGISTER = SETTINGS_START + 1
MOST_AVERAGED = 64
TICKS_PER_S = 10_000
IDENTIFICATION = {0: "loopcal virtual", 1: "modbus-adc", 2: "1.0"}


@dataclass(frozen=True, slots=True)
class Cell:
    """A number in one register or two.

    Attributes:
        address: of its first register.
        kind: "uint16", "int16", "uint32", "int32" or "float32".
        order: where its bytes A (highest) to D are: "ABCD", "CDAB", "BADC" or "DCBA".
    """

    address: int
    kind: str = "uint16"
    order: str = "ABCD"

    @property
    def addresses(self) -> range:
        """Its registers."""
        return range(self.address, self.address + (1 if self.kind.endswith("16") else 2))

    def words(self, value: float) -> list[int]:
        """The values of its registers."""
        if self.order == "ABCD" and self.kind != "float32":
            number = round(value)
            low = number & 0xFFFF
            return [low] if self.kind.endswith("16") else [number >> 16 & 0xFFFF, low]
        size = 2 * len(self.addresses)
        if self.kind == "float32":
            data = struct.pack(">f", value)
        else:
            data = (round(value) & ((1 << 8 * size) - 1)).to_bytes(size, "big")
        letters = self.order if size == 4 else {"BADC": "BA", "DCBA": "BA"}.get(self.order, "AB")
        data = bytes(data["ABCD".index(letter)] for letter in letters)
        return [int.from_bytes(data[at : at + 2], "big") for at in range(0, size, 2)]


@dataclass(frozen=True, slots=True)
class AdcLayout:
    """Where the registers are; options of the rig's device.

    Attributes:
        signals: by what a channel calls them.
        time: device time.
        counter: sample counter, or None where there is none.
        ticks_per_s: of device time.
        resolution: what one count is in a float.
    """

    signals: Mapping[int | str, Cell]
    time: Cell
    counter: Cell | None = None
    ticks_per_s: float = TICKS_PER_S
    resolution: float = 1.0

    @classmethod
    def in_a_row(
        cls, channels: int, first_register: int, counter_register: int | None = None
    ) -> AdcLayout:
        """The plainest: 16 bits a signal, one behind the other, device time in two behind them."""
        return cls(
            signals={k: Cell(first_register + k) for k in range(channels)},
            time=Cell(first_register + channels, "uint32"),
            counter=None if counter_register is None else Cell(counter_register),
        )

    @property
    def cells(self) -> list[Cell]:
        """All of them."""
        counter = [] if self.counter is None else [self.counter]
        return [*self.signals.values(), self.time, *counter]

    @property
    def fits(self) -> bool:
        """Whether all registers differ and lie below the settings."""
        taken = [address for cell in self.cells for address in cell.addresses]
        return len(set(taken)) == len(taken) and max(taken) < SETTINGS_START


class AdcRegisters:
    """The registers of one converter; ``signals`` gives each signal's channel in the rig."""

    def __init__(
        self,
        layout: AdcLayout,
        signals: Mapping[int | str, str],
        plant: Plant,
        crystal: Crystal = PERFECT,
    ) -> None:
        self._crystal = crystal
        self._layout = layout
        self._signals = dict(signals)
        self._plant = plant
        self._samples = 0
        self._settings = {AVERAGING_REGISTER: 1, TAG_REGISTER: 0}
        taken = [address for cell in layout.cells for address in cell.addresses]
        self._measured = range(min(taken), max(taken) + 1)

    def read_input(self, address: int, count: int, time_s: float) -> Sequence[int]:
        """Take a sample; raises RequestRefused outside the first group."""
        wanted = range(address, address + count)
        if wanted[0] not in self._measured or wanted[-1] not in self._measured:
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        sample = self._sample(time_s)
        return [sample.get(register, 0) for register in wanted]

    def read_holding(self, address: int, count: int, time_s: float) -> Sequence[int]:
        """The settings, or a sample; raises RequestRefused for an address of neither."""
        wanted = range(address, address + count)
        if self._settings.keys() >= set(wanted):
            return [self._settings[register] for register in wanted]
        return self.read_input(address, count, time_s)

    def write_holding(self, address: int, values: Sequence[int]) -> None:
        """Change settings; raises RequestRefused, then none has changed."""
        new = dict(enumerate(values, address))
        if not self._settings.keys() >= new.keys():
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        if not 1 <= new.get(AVERAGING_REGISTER, 1) <= MOST_AVERAGED:
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_VALUE)
        self._settings.update(new)

    def identification(self) -> Mapping[int, str]:
        """Vendor, product code, revision."""
        return IDENTIFICATION

    def _sample(self, time_s: float) -> dict[int, int]:
        layout = self._layout
        self._samples += 1
        ticks = int(self._crystal.elapsed(time_s) * layout.ticks_per_s)
        sample = dict(enumerate(layout.time.words(ticks), layout.time.address))
        if layout.counter is not None:
            sample.update(enumerate(layout.counter.words(self._samples), layout.counter.address))
        for signal, cell in layout.signals.items():
            scale = layout.resolution if cell.kind == "float32" else 1
            sample.update(enumerate(cell.words(self._convert(signal) * scale), cell.address))
        return sample

    def _convert(self, signal: int | str) -> int:
        channel = self._signals.get(signal)
        if channel is None:
            return 0
        conversions = self._settings[AVERAGING_REGISTER]
        return round(sum(self._plant.sense(channel) for _ in range(conversions)) / conversions)
