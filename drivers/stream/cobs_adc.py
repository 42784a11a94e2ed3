"""Converters that stream binary frames: COBS packets with a CRC, a sample counter and a clock.

Wire contract: each packet, once unstuffed (`drivers.stream.cobs`), is the fields of option
``fields`` one after the other, then the CRC-16 of them, all in ``byte_order``. A field is
``NAME:TYPE`` with a type out of u8, i8, u16, i16, u32, i32, u64, i64. These names have a meaning,
all others are signals of channels:

    sequence    counts the samples, modulo its width: losses are exact, over wraps too
    time        the device's clock at the sample [time_tick_us], modulo its width
    flags       bits as in recordings: 1 over range, 2 stale, 4 device error
    pad         anything

``NAME:TYPE=VALUE`` is a constant; a packet with another value there is of another kind and is
passed over. `docs/formats.md` recommends a format for firmware that can choose.

Options, beside those of `drivers.stream.sensor.StreamOptions`: ``fields``, ``crc`` (see
`drivers.stream.crc`, or "none"; default "ccitt-false"), ``byte_order`` ("little", "big"; default
"little"), ``time_tick_us`` (default 1). With ``crc = "none"`` a damaged packet of the right length is
taken for a sample.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, model_validator

from drivers.driver import DeviceSpec, Driver
from drivers.stream.cobs import PacketBuffer, decode
from drivers.stream.crc import CRCS, Crc16
from drivers.stream.decoder import Sample
from drivers.stream.link import StreamLink
from drivers.stream.sensor import StreamFormat, StreamOptions, StreamSensor
from recordings.events import ReadingFlag
from recordings.rig import SerialPort
from recordings.rig.quantity import fail

FORMATS = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "i64": "q",
}
FIELD = re.compile(r"([A-Za-z][\w-]*):([ui](?:8|16|32|64))(?:=(\d+))?")
MEANINGS = ("sequence", "time", "flags", "pad")
KNOWN_FLAGS = ReadingFlag.OVERRANGE | ReadingFlag.STALE | ReadingFlag.DEVICE_ERROR
CRC_BYTES = 2
LONGEST_PACKET = 1024


@dataclass(frozen=True, slots=True)
class PacketField:
    """One field: its name, its type (a key of `FORMATS`), and its value where it is constant."""

    name: str
    type: str
    constant: int | None

    @property
    def bits(self) -> int:
        """Width."""
        return int(self.type[1:])


class CobsAdcOptions(StreamOptions):
    """Options of a ``cobs-adc``; see the module."""

    fields: tuple[str, ...]
    crc: Literal["ccitt-false", "xmodem", "modbus", "arc", "none"] = "ccitt-false"
    byte_order: Literal["little", "big"] = "little"
    time_tick_us: int = Field(default=1, ge=1, le=1_000_000)

    @property
    def layout(self) -> tuple[PacketField, ...]:
        """The fields, read."""
        return tuple(_field(text) for text in self.fields)

    @model_validator(mode="after")
    def _fields_make_a_packet(self) -> CobsAdcOptions:
        for text in self.fields:
            if FIELD.fullmatch(text) is None:
                raise fail(f"'fields' has '{text}', expected NAME:TYPE with a type of {_types()}")
        names = [each.name for each in self.layout if each.name != "pad"]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise fail(f"'fields' has '{twice[0]}' twice; names must differ")
        for each in self.layout:
            if each.name in ("sequence", "time") and each.type.startswith("i"):
                raise fail(f"'fields' has '{each.name}:{each.type}', expected an unsigned type")
        if not any(_is_signal(each) for each in self.layout):
            raise fail("'fields' has no signal")
        return self


def _types() -> str:
    return ", ".join(FORMATS)


def _field(text: str) -> PacketField:
    name, kind, constant = FIELD.fullmatch(text).groups()  # type: ignore[union-attr]
    return PacketField(name, kind, None if constant is None else int(constant))


def _is_signal(each: PacketField) -> bool:
    return each.name not in MEANINGS and each.constant is None


class PacketDecoder:
    """See `drivers.stream.decoder.Decoder`."""

    def __init__(self, options: CobsAdcOptions) -> None:
        self._layout = options.layout
        order = "<" if options.byte_order == "little" else ">"
        self._order: Literal["little", "big"] = options.byte_order
        self._struct = struct.Struct(order + "".join(FORMATS[f.type] for f in self._layout))
        self._crc: Crc16 | None = CRCS.get(options.crc)
        self._packets = PacketBuffer(LONGEST_PACKET)
        self._signals = [(k, f.name) for k, f in enumerate(self._layout) if _is_signal(f)]
        self._constants = [
            (k, f.constant) for k, f in enumerate(self._layout) if f.constant is not None
        ]
        at = {f.name: k for k, f in enumerate(self._layout)}
        self._sequence, self._time, self._flags = (at.get(name) for name in MEANINGS[:3])

    def feed(self, data: bytes) -> Sequence[Sample | str]:
        """Samples, and in words what made no sense."""
        taken = (self._take(packet) for packet in self._packets.feed(data))
        return [each for each in taken if each is not None]

    def reset(self) -> None:
        """The stream begins anew, anywhere."""
        self._packets.reset()

    def _take(self, encoded: bytes) -> Sample | str | None:
        try:
            packet = decode(encoded)
        except ValueError as error:
            return f"{error}: {encoded[:40].hex()}"
        if self._crc is not None:
            packet, check = packet[:-CRC_BYTES], packet[-CRC_BYTES:]
            if len(check) < CRC_BYTES or self._crc.of(packet) != int.from_bytes(check, self._order):
                return f"a packet with a wrong CRC: {(packet + check)[:40].hex()}"
        if len(packet) != self._struct.size:
            if self._constants:
                return None  # of another kind, with a length of its own
            return f"a packet of {len(packet)} bytes, expected {self._struct.size}: {packet[:40].hex()}"
        values = self._struct.unpack(packet)
        if any(values[k] != constant for k, constant in self._constants):
            return None
        flags = 0 if self._flags is None else values[self._flags]
        return Sample(
            counts={name: values[k] for k, name in self._signals},
            sequence=None if self._sequence is None else values[self._sequence],
            ticks=None if self._time is None else values[self._time],
            flags=ReadingFlag(flags & int(KNOWN_FLAGS)),
        )


def make(spec: DeviceSpec[CobsAdcOptions]) -> StreamSensor:
    """The converter of ``spec``; raises OptionError."""
    options = spec.options
    bits = {each.name: each.bits for each in options.layout}
    stream = StreamFormat(
        signals=[each.name for each in options.layout if _is_signal(each)],
        counter_bits=bits.get("sequence"),
        clock_bits=bits.get("time"),
        tick_ns=1000 * options.time_tick_us,
    )
    return StreamSensor(spec, PacketDecoder(options), stream)


DRIVER = Driver(options=CobsAdcOptions, ports=(SerialPort,), make=make, link=StreamLink)
