"""Converters that send lines of text, one sample a line.

Wire contract: lines end with LF, CR or both. A line is a sample when it has the form of option
``pattern``: text as it stands, and names in braces where numbers are, as in ``"{time},{x},{y}"`` or
``"X={x} Y={y}"``. Numbers are decimal, with sign, fraction and exponent if need be; spaces beside
them, and at the ends of a line, do not matter, and a space in the pattern stands for any
number of them. Empty lines, and lines that begin with ``comment``, are passed over; any other
line is malformed. These names have a meaning, all others are signals of channels:

    sequence    counts the samples, modulo 2**sequence_bits
    time        the device's clock [time_tick_us], modulo 2**time_bits ticks; may have a fraction
    -           a number that is not wanted

What plain lines cannot show: they have no checksum, so a digit changed or lost on the wire
is a wrong reading that nothing marks. Without ``sequence``, lost lines show only as a pause, and
only where ``sample_hz`` is given. Use a framed stream (``cobs-adc``) where the firmware can be changed.

Options, beside those of `drivers.stream.sensor.StreamOptions`: ``pattern``, ``resolution`` (one
count, in the unit of the numbers; default 1, which takes integers as they are), ``comment``
(default "#"), ``sequence_bits`` (32), ``time_bits`` (32), ``time_tick_us`` (1).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from pydantic import Field, model_validator

from drivers.driver import DeviceSpec, Driver
from drivers.stream.decoder import Sample
from drivers.stream.link import StreamLink
from drivers.stream.sensor import StreamFormat, StreamOptions, StreamSensor
from recordings.rig import SerialPort
from recordings.rig.quantity import fail

PLACE = re.compile(r"\{([A-Za-z][\w-]*|-)\}")
NUMBER = r"([+-]?\d{1,18}(?:\.\d{0,18})?(?:[eE][+-]?\d{1,2})?)"
MEANINGS = ("sequence", "time", "-")
LONGEST_LINE = 1024
LARGEST_COUNT = 2**53
SHOWN_CHARACTERS = 40


class AsciiAdcOptions(StreamOptions):
    """Options of an ``ascii-adc``; see the module."""

    pattern: str
    resolution: float = 1.0
    comment: str = "#"
    sequence_bits: int = Field(default=32, ge=1, le=64)
    time_bits: int = Field(default=32, ge=1, le=64)
    time_tick_us: int = Field(default=1, ge=1, le=1_000_000)

    @property
    def places(self) -> tuple[str, ...]:
        """Names in the pattern, in order."""
        return tuple(PLACE.findall(self.pattern))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of signals."""
        return tuple(name for name in self.places if name not in MEANINGS)

    @model_validator(mode="after")
    def _pattern_has_signals(self) -> AsciiAdcOptions:
        names = [name for name in self.places if name != "-"]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise fail(f"'pattern' has '{{{twice[0]}}}' twice; names must differ")
        if re.search(r"[{}]", PLACE.sub("", self.pattern)) is not None:
            raise fail(f"'pattern' is {self.pattern!r}, whose braces hold no name")
        if re.search(r"\}\{", self.pattern) is not None:
            raise fail(f"'pattern' is {self.pattern!r}, in which two numbers are not separated")
        if not self.signals:
            raise fail(f"'pattern' is {self.pattern!r}, expected a signal in braces")
        if not self.resolution > 0:
            raise fail(f"'resolution' is {self.resolution}, expected above 0")
        return self


class LineDecoder:
    """See `drivers.stream.decoder.Decoder`."""

    def __init__(self, options: AsciiAdcOptions) -> None:
        self._pattern = _compiled(options.pattern)
        self._places = options.places
        self._resolution = options.resolution
        self._comment = options.comment
        self._moduli = {"sequence": 1 << options.sequence_bits, "time": 1 << options.time_bits}
        self._rest = b""
        self._in_step = False

    def feed(self, data: bytes) -> Sequence[Sample | str]:
        """Samples, and in words what made no sense."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if lines and not self._in_step:
            self._in_step = True
            lines = lines[1:]
        if len(self._rest) > LONGEST_LINE:
            if self._in_step:
                lines.append(self._rest)
            self._rest, self._in_step = b"", False
        taken = (self._take(line.decode("latin-1").strip()) for line in lines)
        return [each for each in taken if each is not None]

    def reset(self) -> None:
        """The stream begins anew, anywhere: the first line may have lost its beginning."""
        self._rest = b""
        self._in_step = False

    def _take(self, line: str) -> Sample | str | None:
        if not line or (self._comment and line.startswith(self._comment)):
            return None
        match = self._pattern.fullmatch(line)
        if match is None:
            return f"a line that is not of the rig's pattern: {line[:SHOWN_CHARACTERS]!r}"
        numbers = dict(zip(self._places, match.groups(), strict=True))
        counts = {
            name: self._count(number) for name, number in numbers.items() if name not in MEANINGS
        }
        if any(abs(count) > LARGEST_COUNT for count in counts.values()):
            return f"a line with a count above 2**53: {line[:SHOWN_CHARACTERS]!r}"
        return Sample(
            counts=counts, sequence=self._raw(numbers, "sequence"), ticks=self._raw(numbers, "time")
        )

    def _count(self, number: str) -> int:
        if self._resolution == 1.0 and number.lstrip("+-").isdigit():
            return int(number)
        return round(float(number) / self._resolution)

    def _raw(self, numbers: dict[str, str], name: str) -> int | None:
        if name not in numbers:
            return None
        return round(float(numbers[name])) % self._moduli[name]


def _compiled(pattern: str) -> re.Pattern[str]:
    texts = PLACE.split(pattern)[::2]
    return re.compile(NUMBER.join(_between(text.split(), text) for text in texts))


def _between(words: Sequence[str], text: str) -> str:
    """What stands between two numbers: never nothing, so that their digits do not run together."""
    if not words:
        return r"\s+" if text else ""
    inner = r"\s*".join(re.escape(word) for word in words)
    return rf"\s*{inner}\s*"


def make(spec: DeviceSpec[AsciiAdcOptions]) -> StreamSensor:
    """The converter of ``spec``; raises OptionError."""
    options = spec.options
    stream = StreamFormat(
        signals=options.signals,
        counter_bits=options.sequence_bits if "sequence" in options.places else None,
        clock_bits=options.time_bits if "time" in options.places else None,
        tick_ns=1000 * options.time_tick_us,
    )
    return StreamSensor(spec, LineDecoder(options), stream)


DRIVER = Driver(options=AsciiAdcOptions, ports=(SerialPort,), make=make, link=StreamLink)
