"""Analogue-to-digital converters by Modbus, RTU or TCP: a map of registers, read at once.

Wire contract: one read (function 4, or 3 with ``function = 3``) covers all of

    the signals        16 or 32 bits each, see `drivers.modbus.registers`
    counter_register   u16 or u32, counts samples; optional
    time_register      u16 or u32, the device's time; optional

Signals lie in a row (``first_register``, ``channels``; a channel's ``signal`` is 0, 1, ...) or
anywhere (``signals``, a table by name; a channel's ``signal`` is the name).

A counter that did not move means that the converter gave the same sample again: STALE. What
its steps mean depends on the converter: where each read takes a sample (``counter_counts =
"reads"``), a step above 1 is a sample whose reply was lost; where it converts at a rate of its
own ("conversions", the default), steps tell nothing of losses. Device time that goes back, or
a counter of reads that does, is a restart.

On a serial line, replies carry nothing that ties them to a request but their length. So, after
a request that was given up, the next one asks for a different number of registers; once that is
answered, no earlier reply can come, because a slave answers in order. Only then are samples
read again. Over TCP the transaction ties them.

Identification (function 43/14) is read where the device has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from drivers.arrivals import Arrivals
from drivers.driver import DeviceSpec, Driver
from drivers.errors import DeviceRefused, DeviceSilent, Malformed, OptionError
from drivers.identity import VIRTUAL_PREFIX, Identity
from drivers.modbus.line import Line
from drivers.modbus.link import ModbusLink
from drivers.modbus.pdu import Identify, Read
from drivers.modbus.registers import NumberType, Order, Register
from drivers.tally import Tally
from recordings.events import Event, Fault, Reading
from recordings.faults import FaultKind
from recordings.rig import Channel, SerialPort, TcpPort
from recordings.rig.quantity import Described, fail

MOST_REGISTERS = 125
LARGEST_ADDRESS = 0xFFFF


class SignalOptions(Described):
    """One signal of a register map."""

    address: int = Field(ge=0, le=LARGEST_ADDRESS)
    type: NumberType = "uint16"
    order: Order = "ABCD"


class AdcOptions(Described):
    """Options of a ``modbus-adc``.

    Attributes:
        unit_id: Modbus address; of a TCP server mostly 1 or 255.
        first_register, channels: signals in a row, of one ``type`` and ``order``. By default
            16 bits, in two's complement where the channel's count_range begins below 0.
        signals: signals anywhere, in place of these.
        resolution: one count of a signal of type float32, in the unit that the device gives.
        counter_register, counter_type, counter_counts: see the module.
        time_register, time_type, time_tick_us: device time, and its unit [us].
        function: 4 reads input registers, 3 holding registers.
        timeout: longest time to a reply, beside that on the line [s].
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"timeout": ("s",)}

    unit_id: int = Field(ge=0, le=255)
    first_register: int | None = Field(default=None, ge=0, le=LARGEST_ADDRESS)
    channels: int | None = Field(default=None, ge=1, le=MOST_REGISTERS)
    type: NumberType | None = None
    order: Order = "ABCD"
    signals: dict[str, SignalOptions] = Field(default_factory=dict)
    resolution: float | None = None
    counter_register: int | None = Field(default=None, ge=0, le=LARGEST_ADDRESS)
    counter_type: Literal["uint16", "uint32"] = "uint16"
    counter_counts: Literal["reads", "conversions"] = "conversions"
    time_register: int | None = Field(default=None, ge=0, le=LARGEST_ADDRESS)
    time_type: Literal["uint16", "uint32"] = "uint32"
    time_tick_us: int = Field(default=100, ge=1, le=1_000_000)
    function: Literal[3, 4] = 4
    timeout: float = 0.1

    @property
    def map(self) -> Mapping[str | int, Register]:
        """Signals by what a channel calls them."""
        if self.signals:
            return {
                name: Register(each.address, each.type, each.order)
                for name, each in self.signals.items()
            }
        number: NumberType = self.type or "uint16"
        width = Register(0, number).count
        first, channels = self.first_register or 0, self.channels or 0
        return {k: Register(first + width * k, number, self.order) for k in range(channels)}

    @property
    def counter(self) -> Register | None:
        """The sample counter."""
        if self.counter_register is None:
            return None
        return Register(self.counter_register, self.counter_type, self.order)

    @property
    def time(self) -> Register | None:
        """Device time."""
        if self.time_register is None:
            return None
        return Register(self.time_register, self.time_type, self.order)

    @property
    def address(self) -> int:
        """First register of the read."""
        return min(register.address for _, register in self._all())

    @property
    def count(self) -> int:
        """Number of registers of the read."""
        return max(register.addresses[-1] for _, register in self._all()) - self.address + 1

    def _all(self) -> list[tuple[str, Register]]:
        named = [(f"signal {name}", register) for name, register in self.map.items()]
        for name, register in (("counter_register", self.counter), ("time_register", self.time)):
            if register is not None:
                named.append((f"'{name}'", register))
        return named

    @model_validator(mode="after")
    def _signals_are_said_once(self) -> AdcOptions:
        in_a_row = (self.first_register, self.channels)
        if self.signals and (any(v is not None for v in in_a_row) or self.type is not None):
            raise fail("'signals' says where each signal is; remove first_register, channels, type")
        if not self.signals and None in in_a_row:
            missing = "first_register" if self.first_register is None else "channels"
            raise fail(f"missing key '{missing}' (or give a table 'signals')")
        floats = any(register.type == "float32" for register in self.map.values())
        if floats and self.resolution is None:
            raise fail(
                "a float32 has no counts; say its 'resolution', which is what one count will be"
            )
        if self.resolution is not None and not self.resolution > 0:
            raise fail(f"'resolution' is {self.resolution}, expected above 0")
        if not 0 < self.timeout <= 10:
            raise fail(f"'timeout_s' is {self.timeout}, expected above 0 and at most 10")
        return self

    @model_validator(mode="after")
    def _registers_fit_one_read(self) -> AdcOptions:
        taken: dict[int, str] = {}
        for name, register in self._all():
            if register.addresses[-1] > LARGEST_ADDRESS:
                raise fail(
                    f"{name} is register {register.addresses[-1]}, expected at most {LARGEST_ADDRESS}"
                )
            for address in register.addresses:
                if address in taken:
                    raise fail(
                        f"register {address} is both {taken[address]} and {name}; they must differ"
                    )
                taken[address] = name
        if self.count > MOST_REGISTERS:
            raise fail(
                f"the registers {self.address} to {self.address + self.count - 1} span "
                f"{self.count}, expected at most {MOST_REGISTERS}, which is what one read can give; "
                f"make two devices of it"
            )
        return self


class RegisterMap:
    """Turns the registers of one read into readings. Pure.

    Args:
        options: those of the device.
        channels: what it delivers.
    """

    def __init__(self, options: AdcOptions, channels: Sequence[Channel]) -> None:
        self._options = options
        self._resolution = options.resolution or 1.0
        self._channels = [(channel.name, _register(options, channel)) for channel in channels]
        counter, time = options.counter, options.time
        self._arrivals = Arrivals(
            counter_bits=None if counter is None else counter.bits,
            clock_bits=None if time is None else time.bits,
            tick_ns=1000 * options.time_tick_us,
            counter_only_rises=options.counter_counts == "conversions",
        )

    def readings(self, registers: Sequence[int], time_ns: int) -> tuple[list[Reading], int, bool]:
        """What ``registers`` (as many as were asked for) say, which arrived at ``time_ns``.

        Returns:
            the readings, the samples lost since those before, and whether the device restarted.
        """
        arrival = self._arrivals.take(
            time_ns,
            self._integer(self._options.counter, registers),
            self._integer(self._options.time, registers),
        )
        missed = 0
        if self._options.counter_counts == "reads":
            missed = max((arrival.step or 1) - 1, 0)
        readings = []
        for name, register in self._channels:
            counts = register.counts(self._values(register, registers), self._resolution)
            readings.append(arrival.reading(name, time_ns, counts))
        return readings, missed, arrival.restarted

    def _integer(self, register: Register | None, registers: Sequence[int]) -> int | None:
        return None if register is None else register.integer(self._values(register, registers))

    def _values(self, register: Register, registers: Sequence[int]) -> Sequence[int]:
        at = register.address - self._options.address
        return registers[at : at + register.count]


def _register(options: AdcOptions, channel: Channel) -> Register:
    register = options.map[channel.signal if channel.signal is not None else 0]
    below_zero = channel.count_range is not None and channel.count_range[0] < 0
    if options.type is None and not options.signals and below_zero:
        return Register(register.address, "int16", register.order)
    return register


class ModbusAdc:
    """One converter. See `drivers.modbus.link.PolledDevice`."""

    def __init__(self, spec: DeviceSpec[AdcOptions]) -> None:
        options = spec.options
        known = options.map
        for channel in spec.channels:
            if channel.signal not in known:
                names = list(known)
                has = ", ".join(names) if options.signals else f"0 to {len(names) - 1}"  # type: ignore[arg-type]
                raise OptionError(
                    f"channel '{channel.name}': 'signal' is {channel.signal!r}; the converter "
                    f"'{spec.name}' has the signals {has}"
                )
        if spec.joint is not None:
            raise OptionError(f"device '{spec.name}' is a converter; it moves no 'joint'")
        self.name = spec.name
        self.driver = spec.driver
        self.unit_id = options.unit_id
        self.channels = tuple(channel.name for channel in spec.channels)
        self.tallies: Mapping[str, Tally] = {name: Tally() for name in self.channels}
        self._map = RegisterMap(options, spec.channels)
        self._timeout_s = options.timeout
        self._all = Read(options.unit_id, options.function, options.address, options.count)
        proof_count = 1 if options.count > 1 else 2
        self._proof = Read(options.unit_id, options.function, options.address, proof_count)
        self._owes_a_reply = False
        self._unused = 0

    def identify(self, line: Line) -> Identity:
        """Its identification, with the text "" where it has none; raises DeviceSilent, DeviceRefused, Malformed."""
        self._read(line)
        self._unused += 1
        try:
            answer = line.ask(Identify(self.unit_id), self._timeout_s)
        except (DeviceRefused, DeviceSilent, Malformed):
            # Few converters have this function. A slave that does not know it may stay silent.
            return Identity("", virtual=False)
        text = " ".join(answer.reply.texts)
        return Identity(text, text.startswith(VIRTUAL_PREFIX))

    def poll(self, line: Line) -> Sequence[Event]:
        """One reading of each channel; raises DeviceSilent, DeviceRefused, Malformed or LinkBroken."""
        registers, time_ns = self._read(line)
        readings, missed, restarted = self._map.readings(registers, time_ns)
        # Samples that were read and not wanted have not been lost.
        unused, self._unused = self._unused, 0
        for reading in readings:
            self.tallies[reading.channel].receive(max(missed - unused, 0))
        if restarted:
            text = f"{self.name} has restarted by itself: its counter or clock began anew"
            return [Fault(time_ns, self.name, FaultKind.RESTARTED, text), *readings]
        return readings

    def _read(self, line: Line) -> tuple[Sequence[int], int]:
        if self._owes_a_reply and not line.ties_replies:
            self._settle(line)
        try:
            answer = line.ask(self._all, self._timeout_s)
        except (DeviceSilent, Malformed):
            self._owes_a_reply = True
            raise
        return answer.reply.registers, answer.time_ns

    def _settle(self, line: Line) -> None:
        """Make sure that no reply to an earlier request is under way."""
        try:
            line.ask(self._proof, self._timeout_s)
        except DeviceRefused:
            # A refusal is a reply like any other: what was asked before has been answered.
            self._owes_a_reply = False
            return
        self._unused += 1
        self._owes_a_reply = False


DRIVER = Driver(options=AdcOptions, ports=(SerialPort, TcpPort), make=ModbusAdc, link=ModbusLink)
