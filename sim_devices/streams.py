"""Virtual converters that stream unasked: COBS packets with a CRC, or lines of text.

A converter samples at a rate of its own by its own crystal, from power on, and numbers its
samples and tells its time at each. It sends whatever the host does, or, where it has a start
text, from that text to its stop text. What options mean is said by the drivers of the same
names; the encodings here are this room's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from sim_devices.crystal import Crystal
from sim_devices.plant_seam import Plant

MOST_AT_ONCE = 1000
"""Samples that a converter makes up for after it was held up; what is older it has lost."""


@dataclass(frozen=True, slots=True)
class StreamSample:
    """One sample: its number from 0, device time [us], counts by signal (0 where none is sensed)."""

    number: int
    time_us: float
    counts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class StreamText:
    """Texts of the host by which a converter begins and ends; empty where it always sends."""

    start: bytes = b""
    stop: bytes = b""


class StreamAdc:
    """A converter. See `sim_devices.line.SerialDevice`.

    Args:
        rate_hz: samples a second, by its crystal.
        signals: channel of the rig that each signal senses.
        plant: nature.
        encode: bytes of a sample.
        crystal: what it counts time by.
        text: how it is started and stopped.
    """

    def __init__(
        self,
        rate_hz: float,
        signals: Mapping[str, str],
        plant: Plant,
        encode: Callable[[StreamSample], bytes],
        crystal: Crystal,
        text: StreamText = StreamText(),
    ) -> None:
        self._rate_hz = rate_hz
        self._signals = dict(signals)
        self._plant = plant
        self._encode = encode
        self._crystal = crystal
        self._text = text
        self._sending = not text.start
        self._heard = b""
        self._taken = 0

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Listen for the start and stop texts."""
        self._heard = (self._heard + data)[-64:]
        for text, sending in ((self._text.start, True), (self._text.stop, False)):
            if text and text in self._heard:
                self._sending = sending
                self._heard = b""
        return b""

    def tick(self, time_s: float) -> bytes:
        """The samples that have become due."""
        due = int(self._crystal.elapsed(time_s) * self._rate_hz) + 1
        first = max(self._taken, due - MOST_AT_ONCE)
        self._taken = due
        if not self._sending:
            return b""
        return b"".join(self._encode(self._sample(number)) for number in range(first, due))

    def hang_up(self) -> None:
        """The host has let go of the port: what it had begun to say is forgotten."""
        self._heard = b""

    def _sample(self, number: int) -> StreamSample:
        counts = {name: self._plant.sense(channel) for name, channel in self._signals.items()}
        return StreamSample(number, number * 1e6 / self._rate_hz, counts)


@dataclass(frozen=True, slots=True)
class PacketFormat:
    """The fields of a COBS packet.

    Attributes:
        fields: name, width [bits], and constant value (None where it is none) of each.
        crc: polynomial, start and whether bits are reflected; None for no CRC.
        byte_order: "little" or "big".
        tick_us: unit of the field "time".
    """

    fields: Sequence[tuple[str, int, int | None]]
    crc: tuple[int, int, bool] | None
    byte_order: Literal["little", "big"]
    tick_us: int

    def encode(self, sample: StreamSample) -> bytes:
        """A packet, with its delimiter."""
        values = {
            "sequence": sample.number,
            "time": int(sample.time_us / self.tick_us),
            **sample.counts,
        }
        order = self.byte_order
        packet = b""
        for name, bits, constant in self.fields:
            value = values.get(name, 0) if constant is None else constant
            packet += (value % (1 << bits)).to_bytes(bits // 8, order)
        if self.crc is not None:
            packet += crc16(packet, *self.crc).to_bytes(2, order)
        return stuffed(packet) + b"\0"


CRCS = {
    "ccitt-false": (0x1021, 0xFFFF, False),
    "xmodem": (0x1021, 0x0000, False),
    "modbus": (0x8005, 0xFFFF, True),
    "arc": (0x8005, 0x0000, True),
}
"""Polynomial, start, and whether bits go in and come out lowest first."""


def crc16(data: bytes, polynomial: int, start: int, reflected: bool) -> int:
    """A CRC of 16 bits, bit by bit as it is defined."""
    crc = start
    for byte in data:
        bits = f"{byte:08b}"
        for bit in reversed(bits) if reflected else bits:
            carry = (crc >> 15) ^ int(bit)
            crc = crc << 1 & 0xFFFF
            if carry:
                crc ^= polynomial
    return int(f"{crc:016b}"[::-1], 2) if reflected else crc


def stuffed(packet: bytes) -> bytes:
    """COBS: each run between zeros behind its length plus one, runs of 254 without a zero behind."""
    out = b""
    runs = packet.split(b"\0")
    for number, run in enumerate(runs):
        last = number == len(runs) - 1
        while len(run) >= 254:
            out += b"\xff" + run[:254]
            run = run[254:]
            if not run and last:
                return out
        out += bytes([len(run) + 1]) + run
    return out


def line_of(
    pattern: str, resolution: float, tick_us: int, widths: Mapping[str, int]
) -> Callable[[StreamSample], bytes]:
    """How a sample is written as a line of text, by the pattern of the driver ``ascii-adc``."""
    decimals = (
        0 if resolution == 1.0 else max(len(f"{resolution:.12f}".rstrip("0").partition(".")[2]), 1)
    )

    def written(sample: StreamSample) -> bytes:
        line = pattern
        line = line.replace("{sequence}", str(sample.number % (1 << widths["sequence"])))
        line = line.replace("{time}", str(int(sample.time_us / tick_us) % (1 << widths["time"])))
        for name, counts in sample.counts.items():
            number = str(counts) if decimals == 0 else f"{counts * resolution:.{decimals}f}"
            line = line.replace(f"{{{name}}}", number)
        return line.replace("{-}", "0").encode() + b"\r\n"

    return written
