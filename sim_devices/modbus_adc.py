"""A virtual analogue-to-digital converter: the register map behind a Modbus RTU server.

Input registers (function 4), and the same values as holding registers (function 3); the
addresses come from the device's options in the rig:

    counter_register             sample counter, uint16; none where the option is absent
    first_register + k           raw count of signal k = 0 .. channels - 1, uint16, or int16 in
                                 two's complement where a channel goes below 0
    first_register + channels    device time since power on [100 us], uint32, high word first

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
class AdcLayout:
    """Where the registers are; options of the rig's device.

    Attributes:
        channels: number of signals.
        first_register: address of signal 0.
        counter_register: address of the sample counter, or None where there is none.
    """

    channels: int
    first_register: int
    counter_register: int | None = None

    @property
    def time_register(self) -> int:
        """Address of the high word of device time."""
        return self.first_register + self.channels

    @property
    def fits(self) -> bool:
        """Whether all registers differ and lie below the settings."""
        measured = range(self.first_register, self.time_register + 2)
        counter = self.counter_register
        below = max(measured.stop, 0 if counter is None else counter + 1) <= SETTINGS_START
        return below and counter not in measured


class AdcRegisters:
    """The registers of one converter; ``signals`` gives each signal's channel in the rig."""

    def __init__(
        self,
        layout: AdcLayout,
        signals: Mapping[int, str],
        plant: Plant,
        crystal: Crystal = PERFECT,
    ) -> None:
        self._crystal = crystal
        self._layout = layout
        self._signals = dict(signals)
        self._plant = plant
        self._samples = 0
        self._settings = {AVERAGING_REGISTER: 1, TAG_REGISTER: 0}
        first = layout.first_register
        self._measured = set(range(first, first + layout.channels + 2))
        if layout.counter_register is not None:
            self._measured.add(layout.counter_register)

    def read_input(self, address: int, count: int, time_s: float) -> Sequence[int]:
        """Take a sample; raises RequestRefused outside the first group."""
        wanted = range(address, address + count)
        if not self._measured.issuperset(wanted):
            raise RequestRefused(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        sample = self._sample(time_s)
        return [sample[register] for register in wanted]

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
        ticks = int(self._crystal.elapsed(time_s) * TICKS_PER_S)
        sample = {
            layout.time_register: ticks >> 16 & 0xFFFF,
            layout.time_register + 1: ticks & 0xFFFF,
        }
        if layout.counter_register is not None:
            sample[layout.counter_register] = self._samples & 0xFFFF
        for signal in range(layout.channels):
            sample[layout.first_register + signal] = self._convert(signal) & 0xFFFF
        return sample

    def _convert(self, signal: int) -> int:
        channel = self._signals.get(signal)
        if channel is None:
            return 0
        conversions = self._settings[AVERAGING_REGISTER]
        return round(sum(self._plant.sense(channel) for _ in range(conversions)) / conversions)
