"""Analogue-to-digital converters by Modbus RTU: one register a signal, and a sample counter.

Wire contract: one read (function 4, or 3 with ``function = 3``) covers all of

    counter_register     u16  counts samples; optional
    first_register + k   u16  raw count of signal k = 0 .. channels - 1; two's complement where
                              the channel's count_range begins below 0

A counter that did not move means that the converter gave the same sample again: STALE.
Counters that run faster than the polls are normal, so a step tells nothing about losses.
Identification (function 43/14) is read where the device has it.

Replies carry nothing that ties them to a request but their length. So, after a request that
was given up, the next one asks for a different number of registers; once that is answered, no
earlier reply can come, because a slave answers in order. Only then are samples read again.

Options: ``unit_id`` (1 to 247), ``channels``, ``first_register``, ``counter_register``
(default none), ``function`` (4 input registers, 3 holding registers; default 4),
``timeout_s`` (default 0.1). A channel's ``signal`` is k.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from drivers.counters import WrappingCounter
from drivers.driver import DeviceSpec, Driver
from drivers.errors import DeviceRefused, DeviceSilent, Malformed, OptionError
from drivers.modbus.line import RtuLine
from drivers.modbus.link import ModbusLink
from drivers.modbus.rtu import Identify, Read
from drivers.tally import Tally
from recordings.events import Reading, ReadingFlag
from recordings.rig import Channel, SerialPort
from recordings.rig.quantity import Described, fail

MOST_REGISTERS = 125
LARGEST_ADDRESS = 0xFFFF


class AdcOptions(Described):
    """Options of a ``modbus-adc``."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"timeout": ("s",)}

    unit_id: int = Field(ge=1, le=247)
    channels: int = Field(ge=1, le=MOST_REGISTERS)
    first_register: int = Field(ge=0, le=LARGEST_ADDRESS)
    counter_register: int | None = Field(default=None, ge=0, le=LARGEST_ADDRESS)
    function: Literal[3, 4] = 4
    timeout: float = 0.1

    @property
    def address(self) -> int:
        """First register of the read."""
        if self.counter_register is None:
            return self.first_register
        return min(self.first_register, self.counter_register)

    @property
    def count(self) -> int:
        """Number of registers of the read."""
        last = self.first_register + self.channels - 1
        return max(last, self.counter_register or 0) - self.address + 1

    @model_validator(mode="after")
    def _registers_fit_one_read(self) -> AdcOptions:
        signals = range(self.first_register, self.first_register + self.channels)
        if signals[-1] > LARGEST_ADDRESS:
            raise fail(
                f"the last signal is register {signals[-1]}, expected at most {LARGEST_ADDRESS}"
            )
        if self.counter_register is not None and self.counter_register in signals:
            raise fail(
                f"'counter_register' is {self.counter_register}, which is signal "
                f"{self.counter_register - self.first_register}; the signals are the registers "
                f"{signals[0]} to {signals[-1]}"
            )
        if self.count > MOST_REGISTERS:
            raise fail(
                f"'counter_register' and the signals span {self.count} registers, expected at "
                f"most {MOST_REGISTERS}, which is what one read can give"
            )
        if not 0 < self.timeout <= 10:
            raise fail(f"'timeout_s' is {self.timeout}, expected above 0 and at most 10")
        return self


class RegisterMap:
    """Turns the registers of one read into readings. Pure, but for the counter it follows."""

    def __init__(self, options: AdcOptions, channels: Sequence[Channel]) -> None:
        self._options = options
        self._channels = tuple(channels)
        self._counter = WrappingCounter(16)

    def readings(self, registers: Sequence[int], time_ns: int) -> list[Reading]:
        """The readings in ``registers`` (as many as were asked for), which arrived at ``time_ns``."""
        options = self._options
        flags, sequence = ReadingFlag.NONE, None
        if options.counter_register is not None:
            again = self._counter.value is not None
            step = self._counter.advance(registers[options.counter_register - options.address])
            if again and step == 0:
                flags = ReadingFlag.STALE
            sequence = (self._counter.value or 0) % (1 << 32)
        first = options.first_register - options.address
        return [
            Reading(
                channel=channel.name,
                time_ns=time_ns,
                raw=_count(registers[first + _signal(channel)], channel),
                sequence=sequence,
                flags=flags,
            )
            for channel in self._channels
        ]


def _count(register: int, channel: Channel) -> int:
    below_zero = channel.count_range is not None and channel.count_range[0] < 0
    return register - 0x1_0000 if below_zero and register & 0x8000 else register


def _signal(channel: Channel) -> int:
    return channel.signal if isinstance(channel.signal, int) else 0


class ModbusAdc:
    """One converter. See `drivers.modbus.link.PolledDevice`."""

    def __init__(self, spec: DeviceSpec[AdcOptions]) -> None:
        options = spec.options
        for channel in spec.channels:
            signal = channel.signal
            if not isinstance(signal, int) or not 0 <= signal < options.channels:
                raise OptionError(
                    f"channel '{channel.name}': 'signal' is {signal!r}; the converter "
                    f"'{spec.name}' has the signals 0 to {options.channels - 1}"
                )
        if spec.joint is not None:
            raise OptionError(f"device '{spec.name}' is a converter; it moves no 'joint'")
        self.name = spec.name
        self.driver = spec.driver
        self.unit_id = options.unit_id
        self.tallies: Mapping[str, Tally] = {channel.name: Tally() for channel in spec.channels}
        self._map = RegisterMap(options, spec.channels)
        self._timeout_s = options.timeout
        self._all = Read(options.unit_id, options.function, options.address, options.count)
        proof_count = 1 if options.count > 1 else 2
        self._proof = Read(options.unit_id, options.function, options.address, proof_count)
        self._owes_a_reply = False

    def identify(self, line: RtuLine) -> str:
        """Its identification, "" where it has none; raises DeviceSilent, DeviceRefused, Malformed."""
        self._read(line)
        try:
            answer = line.ask(Identify(self.unit_id), self._timeout_s)
        except (DeviceRefused, DeviceSilent, Malformed):
            # Few converters have this function. A slave that does not know it may stay silent.
            return ""
        return " ".join(answer.reply.texts)

    def poll(self, line: RtuLine) -> Sequence[Reading]:
        """One reading of each channel; raises DeviceSilent, DeviceRefused, Malformed or LinkBroken."""
        registers, time_ns = self._read(line)
        return self._map.readings(registers, time_ns)

    def _read(self, line: RtuLine) -> tuple[Sequence[int], int]:
        if self._owes_a_reply:
            self._settle(line)
        try:
            answer = line.ask(self._all, self._timeout_s)
        except (DeviceSilent, Malformed):
            self._owes_a_reply = True
            raise
        return answer.reply.registers, answer.time_ns

    def _settle(self, line: RtuLine) -> None:
        """Make sure that no reply to an earlier request is under way."""
        try:
            line.ask(self._proof, self._timeout_s)
        except DeviceRefused:
            # A refusal is a reply like any other: what was asked before has been answered.
            self._owes_a_reply = False
            return
        self._owes_a_reply = False


DRIVER = Driver(options=AdcOptions, ports=(SerialPort,), make=ModbusAdc, link=ModbusLink)
