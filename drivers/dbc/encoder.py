"""Encoders and other sensors whose CAN messages a DBC file describes; they send unasked.

Wire contract: the DBC file that the device names as its ``file``. Nothing is sent to the
device, so it works on a port with ``listen_only`` too, beside another master.

A channel's ``signal`` is ``MESSAGE.SIGNAL``, or the signal alone where one message has it. Its
counts are the signal's raw value, before the DBC's factor and offset. A multiplexed signal is
read from the frames that have it.

Options, all optional:

    counter      name of the signal that counts the messages, in each message of the channels
                 that has one: losses are then exact. Not used for multiplexed signals
    clock        name of the signal that is the device's time, likewise
    clock_tick_us   its unit [us], default 1
    invalid      raw value that means "not available": such a reading is flagged DEVICE_ERROR
    cycle_ms     time between two messages, in place of GenMsgCycleTime
    timeout_s    time without a message after which it is called silent; default: five cycles,
                 at least 0.1 s, or 0.5 s where no cycle is known
"""

from __future__ import annotations

import queue
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat
from typing import ClassVar

from pydantic import Field, model_validator

from drivers.arrivals import Arrivals
from drivers.can_bus import Frame
from drivers.can_device import CanWire, Identity
from drivers.can_link import CanLink
from drivers.dbc.database import DbcFile, DbcMessage, DbcSignal
from drivers.dbc.layout import Block
from drivers.dbc.message_watch import MessageWatch, doubled_fault
from drivers.driver import DeviceSpec, Driver
from drivers.errors import DeviceSilent, Malformed, OptionError
from drivers.link import JointDrive, Losses
from drivers.schedule import SECOND
from drivers.stream_tally import StreamTally
from drivers.tally import Tally
from recordings.events import Event, Fault, Reading, ReadingFlag
from recordings.faults import FaultKind
from recordings.rig import CanPort, Channel
from recordings.rig.quantity import Described, fail

CYCLES_OF_SILENCE = 5
SHORTEST_SILENCE_NS = SECOND // 10
UNKNOWN_SILENCE_NS = SECOND // 2
_BAD = ReadingFlag.DEVICE_ERROR


class DbcEncoderOptions(Described):
    """Options of a ``dbc-encoder``."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"timeout": ("s",)}

    counter: str | None = None
    clock: str | None = None
    clock_tick_us: int = Field(default=1, ge=1, le=1_000_000)
    invalid: int | None = None
    cycle_ms: int | None = Field(default=None, ge=1, le=60_000)
    timeout: float | None = None

    @model_validator(mode="after")
    def _timeout_is_a_time(self) -> DbcEncoderOptions:
        if self.timeout is not None and not 0 < self.timeout <= 60:
            raise fail(f"'timeout_s' is {self.timeout}, expected above 0 and at most 60")
        return self


class MessageTrack:
    """Turns the frames of one message into readings of its channels. Pure.

    Args:
        message: the message.
        channels: channels and the signals that they read.
        options: those of the device.
    """

    def __init__(
        self,
        message: DbcMessage,
        channels: Sequence[tuple[Channel, DbcSignal]],
        options: DbcEncoderOptions,
    ) -> None:
        self.name = message.name
        self.identifier = message.identifier
        self._invalid = options.invalid
        counter = _optional(message, options.counter)
        clock = _optional(message, options.clock)
        self._counter, self._clock = counter, clock
        self._count = None if counter is None else counter.reader
        self._ticks = None if clock is None else clock.reader
        period_ns = message.period_ns if options.cycle_ms is None else options.cycle_ms * 1_000_000
        self._arrivals = Arrivals(
            counter_bits=None if counter is None else counter.layout.length,
            clock_bits=None if clock is None else clock.layout.length,
            tick_ns=options.clock_tick_us * 1000,
            period_ns=period_ns,
        )
        self._channels = [
            (channel.name, signal, StreamTally(None if signal.multiplexed else period_ns))
            for channel, signal in channels
        ]
        self._readers = [signal.reader for _, signal in channels]
        self.tallies = {name: tally for name, _, tally in self._channels}
        self.timeout_ns = UNKNOWN_SILENCE_NS
        if options.timeout is not None:
            self.timeout_ns = round(options.timeout * SECOND)
        elif period_ns is not None:
            self.timeout_ns = max(CYCLES_OF_SILENCE * period_ns, SHORTEST_SILENCE_NS)
        self.watch = MessageWatch(self.timeout_ns)

    def readings(self, frame: Frame) -> tuple[list[Reading], bool]:
        """The readings in a frame, and whether the device has restarted; raises Malformed."""
        data, time_ns = frame.data, frame.time_ns
        values = [read(data) for read in self._readers]
        arrival = self._arrivals.take(
            time_ns,
            None if self._count is None else self._count(data),
            None if self._ticks is None else self._ticks(data),
        )
        sequence, device_time_ns, step, restarted = arrival
        flags = arrival.flags
        if self.watch.doubled:
            # Whose reading it is, and whose counter, cannot be known.
            sequence, device_time_ns, step, restarted = None, None, 1, False
            flags = ReadingFlag.DEVICE_ERROR
        if device_time_ns is None:
            device_time_ns = frame.device_time_ns
        readings = []
        for (name, signal, tally), raw in zip(self._channels, values, strict=True):
            if raw is None:
                continue
            own = flags | ReadingFlag.DEVICE_ERROR if raw == self._invalid else flags
            tally.receive(time_ns, None if signal.multiplexed else step)
            readings.append(Reading(name, time_ns, raw, device_time_ns, sequence, own))
        return readings, restarted

    def readings_on(self, frames: Sequence[Frame]) -> list[Reading] | None:
        """The readings in more frames of the moment of the last one, if they go on from it regularly.

        None, and nothing is taken, where a counter jumps, a frame is short, a signal comes and
        goes, or anything is in doubt: then `readings` has to judge frame by frame.
        """
        sizes = {len(frame.data) for frame in frames}
        if self._counter is None or not self._steady or len(sizes) != 1:
            return None
        block = Block([frame.data for frame in frames], sizes.pop())
        try:
            columns = [signal.layout.column(block) for _, signal, _ in self._channels]
            counts = self._counter.layout.column(block)
            ticks = None if self._clock is None else self._clock.layout.column(block)
        except Malformed:
            return None
        going_on = self._arrivals.take_on(frames[0].time_ns, counts, ticks)
        if going_on is None:
            return None
        sequences, times = going_on
        device_times: Iterable[int | None] = times or [frame.device_time_ns for frame in frames]
        readings: list[Reading] = []
        for (name, _, tally), raws in zip(self._channels, columns, strict=True):
            tally.receive_on(len(frames))
            flags: Iterable[ReadingFlag] = repeat(ReadingFlag.NONE)
            if self._invalid in raws:
                flags = [_BAD if raw == self._invalid else ReadingFlag.NONE for raw in raws]
            arrived = repeat(frames[0].time_ns)
            readings += map(Reading, repeat(name), arrived, raws, device_times, sequences, flags)
        self.watch.hear_on(len(frames))
        return readings

    @property
    def _steady(self) -> bool:
        return not self.watch.doubled and all(
            tally.steady and not signal.multiplexed for _, signal, tally in self._channels
        )


def _optional(message: DbcMessage, name: str | None) -> DbcSignal | None:
    """A counter or clock, which wraps from its highest to 0 even if called signed."""
    if name is None or name not in message.signal_names:
        return None
    return message.signal(name).unsigned


class DbcEncoder:
    """One device. See `drivers.can_device.CanDevice`."""

    sends = False
    service = None
    drive: JointDrive | None = None
    tallies: Mapping[str, Tally]

    def __init__(self, spec: DeviceSpec[DbcEncoderOptions]) -> None:
        if spec.joint is not None:
            raise OptionError(f"device '{spec.name}' is a sensor; it moves no 'joint'")
        if not spec.channels:
            raise OptionError(f"device '{spec.name}' delivers no channel of the rig")
        self.name = spec.name
        self.driver = spec.driver
        self.channels = tuple(channel.name for channel in spec.channels)
        self.tallies = {}
        self._tracks = {track.identifier: track for track in _tracks(spec)}
        self.identifiers = tuple(self._tracks)
        self._streams = {
            name: tally for track in self._tracks.values() for name, tally in track.tallies.items()
        }
        self._asked: queue.Queue[bytes] | None = None
        self._unheard: set[int] = set()
        self._started = False

    def attach(self, wire: CanWire) -> None:
        """Belong to a bus."""
        self._wire = wire

    def identify(self) -> Identity:
        """Listen until each of its messages has come; raises DeviceSilent or LinkBroken."""
        self._unheard = set(self._tracks)
        self._asked = queue.Queue()
        timeout_s = max(track.timeout_ns for track in self._tracks.values()) / SECOND
        try:
            self._wire.await_answer(self._asked, timeout_s)
        except queue.Empty as error:
            missing = ", ".join(
                f"{track.name} (identifier 0x{i & 0x1FFF_FFFF:X})"
                for i, track in self._tracks.items()
                if i in self._unheard
            )
            raise DeviceSilent(
                f"{self.name} has not sent {missing} within {timeout_s:g} s; check its identifier, "
                f"the bit rate, power and wiring, and whether it sends unasked"
            ) from error
        finally:
            self._asked = None
        names = ", ".join(track.name for track in self._tracks.values())
        return Identity(f"sends {names}", virtual=False)

    def start(self) -> None:
        """From now on its messages are expected."""
        now_ns = self._wire.now_ns()
        for track in self._tracks.values():
            track.watch.begin(now_ns)
        for tally in self._streams.values():
            tally.begin(now_ns)
        self._started = True

    def stop(self, now_ns: int) -> None:
        """Nothing is expected any more."""
        self._started = False
        for tally in self._streams.values():
            tally.end(now_ns)

    def interrupt(self) -> None:
        """The port has gone away."""
        for track in self._tracks.values():
            track.watch.end()
        for tally in self._streams.values():
            tally.interrupt()

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """Losses of each channel so far."""
        return {name: tally.losses(now_ns) for name, tally in self._streams.items()}

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take one of its messages; raises Malformed."""
        track = self._tracks[frame.identifier]
        self._unheard.discard(frame.identifier)
        if self._asked is not None and not self._unheard:
            self._asked.put(b"")
        if not self._started:
            return ()
        readings, restarted = track.readings(frame)
        events: Sequence[Event] = readings
        if track.watch.hear(frame.time_ns):
            text = f"{self.name} sends {track.name} again"
            events = [Fault(frame.time_ns, self.name, FaultKind.ANSWERING, text), *readings]
        if restarted:
            text = f"{self.name} has restarted by itself: its counter or clock began anew"
            self._wire.fault(frame.time_ns, self.name, FaultKind.RESTARTED, text)
        return events

    def receive_on(self, frames: Sequence[Frame]) -> Sequence[Event] | None:
        """Take more frames of one message at once. See `drivers.can_device.TakesBlocks`."""
        if not self._started:
            return ()
        return self._tracks[frames[0].identifier].readings_on(frames)

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Say once of each message that it has not come for long, or that two send it."""
        if not self._started:
            return ()
        faults = []
        for track in self._tracks.values():
            if track.watch.falls_silent(now_ns):
                text = f"{self.name} has not sent {track.name} for {track.timeout_ns / SECOND:g} s"
                faults.append(Fault(now_ns, self.name, FaultKind.SILENT, text))
            if track.watch.doubles(now_ns):
                faults.append(doubled_fault(now_ns, self.name, track.name, track.watch))
        return faults

    def due_ns(self) -> int | None:
        """Silence is noticed soon enough as it is."""
        return None


def _tracks(spec: DeviceSpec[DbcEncoderOptions]) -> list[MessageTrack]:
    """One track a message that carries a channel; raises OptionError."""
    if spec.file is None:
        raise OptionError(f"device '{spec.name}' ({spec.driver}) needs the 'file' of its DBC")
    dbc = DbcFile(spec.file, f"the file of device '{spec.name}'")
    messages: dict[str, DbcMessage] = {}
    channels: dict[str, list[tuple[Channel, DbcSignal]]] = {}
    for channel in spec.channels:
        if not isinstance(channel.signal, str):
            raise OptionError(
                f"channel '{channel.name}': 'signal' is {channel.signal!r}, expected "
                f"\"MESSAGE.SIGNAL\" of the DBC of '{spec.name}'"
            )
        message, name = dbc.find(channel.signal)
        messages[message.name] = message
        channels.setdefault(message.name, []).append((channel, message.signal(name)))
    for key in ("counter", "clock"):
        name = getattr(spec.options, key)
        if name is not None and all(name not in m.signal_names for m in messages.values()):
            known = ", ".join(dict.fromkeys(n for m in messages.values() for n in m.signal_names))
            raise OptionError(
                f"device '{spec.name}': '{key}' is '{name}', but its messages have the signals {known}"
            )
    return [
        MessageTrack(message, channels[name], spec.options) for name, message in messages.items()
    ]


DRIVER = Driver(options=DbcEncoderOptions, ports=(CanPort,), make=DbcEncoder, link=CanLink)
