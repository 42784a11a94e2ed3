"""Absolute encoders by CANopen, device profile CiA 406.

Wire contract (node id n, little-endian):

    TPDO1 0x180 + n  on SYNC  bytes 0-3  u32  position [counts]
                              bytes 4-5  u16  sample counter, where the device has one
                              bytes 6-7  u16  device time [100 us], where the device has one
    0x6004   u32  position, the same by SDO
    0x1800:2 u8   transmission type of TPDO1: set to 1 (each SYNC) where it is not

A plain CiA 406 encoder sends the first 4 bytes only. ``tpdo = 2`` takes TPDO2 (0x280 + n,
0x1801) instead, which many encoders have set up for SYNC.

Options: ``node_id`` (1 to 127), ``tpdo`` (1 to 4, default 1). One channel, ``signal`` absent
or "position".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import Field

from drivers.can_bus import Frame
from drivers.can_device import Identity
from drivers.can_link import CanLink
from drivers.canopen.device import Wire
from drivers.canopen.doubles import DoubleWatch
from drivers.canopen.identity import identify
from drivers.canopen.master import NMT, NMT_START, CanopenMaster
from drivers.canopen.sdo import Sdo
from drivers.counters import WrappingCounter
from drivers.driver import DeviceSpec, Driver
from drivers.errors import DeviceRefused, Malformed, OptionError
from drivers.link import JointDrive, Losses
from drivers.round_trips import RoundTrips
from drivers.schedule import SECOND
from drivers.silence import SilenceWatch
from drivers.tally import Tally
from recordings.events import Event, Fault, Reading, ReadingFlag
from recordings.faults import FaultKind
from recordings.rig import CanPort
from recordings.rig.quantity import Described

PROFILE = 406
TICK_NS = 100_000
EACH_SYNC = 1
SILENT_NS = SECOND // 2
"""How long SYNC may go unanswered before the encoder is called silent."""


class EncoderOptions(Described):
    """Options of a ``canopen-encoder``."""

    node_id: int = Field(ge=1, le=127)
    tpdo: int = Field(default=1, ge=1, le=4)


@dataclass(frozen=True, slots=True)
class Sample:
    """What a position PDO says.

    Attributes:
        position: counts.
        counter: sample counter modulo 2**16, or None.
        ticks: device time modulo 2**16 [100 us], or None.
    """

    position: int
    counter: int | None
    ticks: int | None


def decode(data: bytes) -> Sample:
    """Read a position PDO of 4 to 8 bytes; raises Malformed."""
    if len(data) < 4:
        raise Malformed(f"a position PDO of {len(data)} bytes ({data.hex()}), expected 4 to 8")
    counter = int.from_bytes(data[4:6], "little") if len(data) >= 6 else None
    ticks = int.from_bytes(data[6:8], "little") if len(data) >= 8 else None
    return Sample(int.from_bytes(data[:4], "little"), counter, ticks)


class SampleTrack:
    """Turns the samples of one encoder into readings, in order. Pure.

    Args:
        channel: channel that the readings belong to.
        tally: counts them.
    """

    def __init__(self, channel: str, tally: Tally) -> None:
        self._channel = channel
        self._tally = tally
        self._counter = WrappingCounter(16)
        self._ticks = WrappingCounter(16)
        self._last_ns: int | None = None

    def reading(self, sample: Sample, time_ns: int, adapter_ns: int | None = None) -> Reading:
        """The reading of ``sample``, which arrived at ``time_ns``; it is counted.

        ``adapter_ns`` is the adapter's time stamp: the device time of an encoder without a clock.

        A sample whose counter did not move is flagged STALE: the same sample, sent again.
        """
        flags = ReadingFlag.NONE
        step = 1
        if sample.counter is not None:
            first = self._counter.value is None
            step = self._counter.advance(sample.counter, expected=1)
            if first:
                step = 1
        if step == 0:
            flags = ReadingFlag.STALE
            self._tally.receive_unasked()
        else:
            self._tally.receive(missed=max(step - 1, 0))
        return Reading(
            channel=self._channel,
            time_ns=time_ns,
            raw=sample.position,
            device_time_ns=adapter_ns
            if sample.ticks is None
            else self._device_time_ns(sample.ticks, time_ns),
            sequence=None if self._counter.value is None else self._counter.value % (1 << 32),
            flags=flags,
        )

    def doubtful(self, sample: Sample, time_ns: int, *, asked: bool) -> Reading:
        """The reading of a sample that may be another device's: flagged, its counter ignored."""
        if asked:
            self._tally.receive()
        else:
            self._tally.receive_unasked()
        self.restart()
        return Reading(self._channel, time_ns, sample.position, flags=ReadingFlag.DEVICE_ERROR)

    def restart(self) -> None:
        """The device has booted: its counter and its time begin anew."""
        self._counter.restart()
        self._ticks.restart()

    def _device_time_ns(self, ticks: int, time_ns: int) -> int:
        # The ticks wrap every 6.6 s; the host's time tells how often they did in a longer pause.
        since_ns = 0 if self._last_ns is None else time_ns - self._last_ns
        self._last_ns = time_ns
        self._ticks.advance(ticks, expected=round(since_ns / TICK_NS))
        return (self._ticks.value or 0) * TICK_NS


class Encoder:
    """One encoder. See `drivers.canopen.device.CanopenDevice`."""

    master_id: int | None = None
    drive: JointDrive | None = None
    sends = True
    service = CanopenMaster

    def __init__(self, spec: DeviceSpec[EncoderOptions]) -> None:
        if len(spec.channels) > 1:
            names = ", ".join(channel.name for channel in spec.channels)
            raise OptionError(f"device '{spec.name}' has one signal, but the channels {names}")
        for channel in spec.channels:
            if channel.signal not in (None, "position"):
                raise OptionError(
                    f"channel '{channel.name}': 'signal' is {channel.signal!r}; the encoder "
                    f"'{spec.name}' has only \"position\""
                )
        self.name = spec.name
        self.driver = spec.driver
        self.node_id = spec.options.node_id
        self.identifiers = (0x80 + 0x100 * spec.options.tpdo + self.node_id,)
        self.channels = tuple(channel.name for channel in spec.channels)
        self.tallies = {name: Tally() for name in self.channels}
        self._tracks = [SampleTrack(name, tally) for name, tally in self.tallies.items()]
        self._parameters = 0x1800 + spec.options.tpdo - 1
        self._silence = SilenceWatch(SILENT_NS)
        self._answers = DoubleWatch()
        self._round_trips = RoundTrips(self.name)

    def attach(self, wire: Wire) -> None:
        """Belong to a bus."""
        self._wire = wire
        self._sdo: Sdo = wire.sdo(self.node_id)

    def identify(self) -> Identity:
        """Ask it who it is; raises DeviceSilent, DeviceRefused or LinkBroken."""
        return identify(self._sdo, PROFILE, "encoder")

    def position(self) -> int:
        """Position now [counts], by SDO; raises as `identify`."""
        return self._sdo.read_integer(0x6004)

    def start(self) -> None:
        """Let it send its position on each SYNC; raises as `identify`."""
        self._silence.end()
        try:
            transmission = self._sdo.read_integer(self._parameters, 2)
        except DeviceRefused:
            # A simple encoder has fixed PDOs and does not show their parameters.
            transmission = EACH_SYNC
        if transmission != EACH_SYNC:
            self._sdo.write(self._parameters, 2, EACH_SYNC, size=1)
        self._wire.send(NMT, bytes([NMT_START, self.node_id]))

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a position PDO; raises Malformed."""
        sample = decode(frame.data)
        events: list[Event] = []
        if self._answers.answer(frame.time_ns):
            text = (
                f"two devices answer as node {self.node_id}, which is {self.name}: give one of them "
                f"another node id; until then readings are flagged, because either may be the other's"
            )
            events.append(Fault(frame.time_ns, self.name, FaultKind.DUPLICATED, text))
        if self._answers.doubled:
            asked = not self._answers.surplus
            events += [track.doubtful(sample, frame.time_ns, asked=asked) for track in self._tracks]
        else:
            events += [
                track.reading(sample, frame.time_ns, frame.device_time_ns) for track in self._tracks
            ]
            events += self._round_trips.answered(self._answers.asked_ns, frame.time_ns)
        if self._silence.hear(frame.time_ns):
            text = f"{self.name} answers again"
            events.insert(0, Fault(frame.time_ns, self.name, FaultKind.ANSWERING, text))
        return events

    def serve(self, now_ns: int) -> Sequence[Event]:
        """It is asked by SYNC alone."""
        return ()

    def due_ns(self) -> int | None:
        """See `serve`."""
        return None

    def stop(self, now_ns: int) -> None:
        """Nothing is asked of it any more."""

    def interrupt(self) -> None:
        """The port has gone away; the link counts what that costs."""

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """Losses of its channel so far."""
        return {name: tally.losses() for name, tally in self.tallies.items()}

    def sync(self, time_ns: int) -> Sequence[Event]:
        """A SYNC was sent: say so once when none has been answered for long."""
        if not self._silence.expects:
            self._silence.begin(time_ns)
        if self._answers.ask(time_ns):
            text = f"only one device answers as node {self.node_id} again"
            return (Fault(time_ns, self.name, FaultKind.SINGLE, text),)
        if not self._tracks or not self._silence.falls_silent(time_ns):
            return ()
        text = f"{self.name} (node {self.node_id}) has not answered SYNC for {SILENT_NS / SECOND} s"
        return (Fault(time_ns, self.name, FaultKind.SILENT, text),)

    def emergency(self, code: int, time_ns: int) -> Sequence[Event]:
        """Its own errors are reported by the link; they change nothing here."""
        return ()

    def restarted(self) -> None:
        """It has booted."""
        for track in self._tracks:
            track.restart()


DRIVER = Driver(options=EncoderOptions, ports=(CanPort,), make=Encoder, link=CanLink)
