"""A sensor that streams its samples through a serial port: samples become readings, counted.

Knows no encoding: a `drivers.stream.decoder.Decoder` turns bytes into samples. Losses are exact
where the stream has a sample counter, estimated where only its rate is known
(`drivers.stream_tally`), and cannot be seen where neither is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from pydantic import model_validator

from drivers.arrivals import Arrivals
from drivers.driver import DeviceSpec
from drivers.errors import OptionError
from drivers.link import Losses
from drivers.schedule import SECOND
from drivers.silence import SilenceWatch
from drivers.stream.decoder import Decoder, Sample
from drivers.stream_tally import StreamTally
from recordings.events import Event, Fault
from recordings.faults import FaultKind
from recordings.rig.quantity import Described, fail

PERIODS_OF_SILENCE = 5
SHORTEST_SILENCE_NS = SECOND // 10
UNKNOWN_SILENCE_NS = SECOND // 2


class StreamOptions(Described):
    """Options that all streaming sensors share.

    Attributes:
        sample: rate at which the sensor sends [Hz], None where it is not known.
        timeout: time without a sample after which it is called silent [s]; default: five
            periods, at least 0.1 s, or 0.5 s where the rate is not known.
        start_text, stop_text: what to send to the sensor for it to begin and to end.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"sample": ("hz",), "timeout": ("s",)}

    sample: float | None = None
    timeout: float | None = None
    start_text: str = ""
    stop_text: str = ""

    @model_validator(mode="after")
    def _times_are_times(self) -> StreamOptions:
        if self.sample is not None and not 0 < self.sample <= 1e6:
            raise fail(f"'sample_hz' is {self.sample}, expected above 0 and at most 1e6")
        if self.timeout is not None and not 0 < self.timeout <= 60:
            raise fail(f"'timeout_s' is {self.timeout}, expected above 0 and at most 60")
        return self


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """What a stream carries beside its counts.

    Attributes:
        signals: names that a channel can take.
        counter_bits: width of its sample counter, None where it has none.
        clock_bits: width of its clock, None where it has none.
        tick_ns: one tick of its clock [ns].
    """

    signals: Collection[str]
    counter_bits: int | None = None
    clock_bits: int | None = None
    tick_ns: int = 1000


class StreamSensor:
    """One sensor. See `drivers.stream.link.StreamLink`.

    Args:
        spec: the device of the rig; its options are `StreamOptions` or derived from them.
        decoder: makes samples of its bytes.
        stream: what the stream carries.

    Raises:
        OptionError: a channel asks for a signal that the stream has not.
    """

    def __init__(
        self, spec: DeviceSpec[StreamOptions], decoder: Decoder, stream: StreamFormat
    ) -> None:
        if spec.joint is not None:
            raise OptionError(f"device '{spec.name}' is a sensor; it moves no 'joint'")
        for channel in spec.channels:
            if channel.signal not in stream.signals:
                raise OptionError(
                    f"channel '{channel.name}': 'signal' is {channel.signal!r}; the stream of "
                    f"'{spec.name}' has the signals {', '.join(stream.signals)}"
                )
        self.name = spec.name
        self.driver = spec.driver
        self.options = spec.options
        self.channels = {channel.name: str(channel.signal) for channel in spec.channels}
        self._decoder = decoder
        period_ns = None if spec.options.sample is None else round(SECOND / spec.options.sample)
        self._arrivals = Arrivals(stream.counter_bits, stream.clock_bits, stream.tick_ns, period_ns)
        self._tallies = {name: StreamTally(period_ns) for name in self.channels}
        if spec.options.timeout is not None:
            self.timeout_ns = round(spec.options.timeout * SECOND)
        elif period_ns is not None:
            self.timeout_ns = max(PERIODS_OF_SILENCE * period_ns, SHORTEST_SILENCE_NS)
        else:
            self.timeout_ns = UNKNOWN_SILENCE_NS
        self._silence = SilenceWatch(self.timeout_ns)

    def reset(self) -> None:
        """The port has been opened: the stream begins anywhere."""
        self._decoder.reset()

    def start(self, now_ns: int) -> None:
        """From now on samples are expected."""
        self._silence.begin(now_ns)
        for tally in self._tallies.values():
            tally.begin(now_ns)

    def stop(self, now_ns: int) -> None:
        """No samples are expected any more."""
        self._silence.end()
        for tally in self._tallies.values():
            tally.end(now_ns)

    def interrupt(self) -> None:
        """The port has gone away."""
        for tally in self._tallies.values():
            tally.interrupt()

    def samples(self, data: bytes) -> Sequence[Sample | str]:
        """What has come, decoded: samples, and in words what made no sense."""
        return self._decoder.feed(data)

    def readings(self, sample: Sample, time_ns: int) -> list[Event]:
        """The readings of ``sample``, which arrived at ``time_ns``; they are counted."""
        arrival = self._arrivals.take(time_ns, sample.sequence, sample.ticks)
        events: list[Event] = []
        if self._silence.hear(time_ns):
            events.append(
                Fault(time_ns, self.name, FaultKind.ANSWERING, f"{self.name} sends again")
            )
        if arrival.restarted:
            text = f"{self.name} has restarted by itself: its counter or clock began anew"
            events.append(Fault(time_ns, self.name, FaultKind.RESTARTED, text))
        for name, signal in self.channels.items():
            self._tallies[name].receive(time_ns, arrival.step)
            events.append(arrival.reading(name, time_ns, sample.counts[signal], sample.flags))
        return events

    def silence(self, now_ns: int) -> Sequence[Event]:
        """Say once that no sample has come for long."""
        if not self._silence.falls_silent(now_ns):
            return ()
        text = f"{self.name} has sent no sample for {self.timeout_ns / SECOND:g} s"
        return (Fault(now_ns, self.name, FaultKind.SILENT, text),)

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """Losses of each channel so far."""
        return {name: tally.losses(now_ns) for name, tally in self._tallies.items()}
