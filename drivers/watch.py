"""What can be wrong with the readings of any driver, seen without knowing its protocol.

A `WatchedLink` is a link like the one that it watches, and adds the faults that show in readings
and losses alone:

    STUCK      a channel gives one count for longer than its noise allows, or its device says
               that the sample is an old one, for `STUCK_S` at least
    LOSING     readings are missing although nothing else is known to be wrong
    SILENT     a channel has given nothing for `SILENT_S`, and nothing else says so
    RESTARTED  a sample counter has gone back and counts on from there

each with its end. What the link itself has reported of a port or device explains what its
channels lack, and is not said twice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers.link import Clock, DeviceStatus, JointDrive, Link, Losses
from drivers.schedule import SECOND
from drivers.silence import SilenceWatch
from recordings.events import Event, Fault, Reading, ReadingFlag
from recordings.faults import ENDED_BY, FaultKind
from recordings.rig import Channel

STUCK_S = 1.0
"""A channel is not called stuck before it has given one count for so long."""

SILENT_S = 1.0
SILENT_PERIODS = 10
"""Of the sampling, for channels that are sampled slowly."""

LOOK_NS = SECOND // 10
"""Time between two looks at the losses."""

COMPLETE_S = 1.0
"""How long nothing may be lost for a channel to be complete again."""

FALSE_ALARM = 1e-12
"""Probability that a channel with the noise of the rig repeats a count so often by chance."""

CONFIRMING = 3
"""Readings that must follow a counter that went back, for its device to have restarted."""

HALF_COUNTER = 1 << 31


def repeats_allowed(noise: float) -> float:
    """How often in a row a channel can give one count, if it measures; infinite without noise.

    With Gaussian noise of standard deviation ``noise`` [counts] about a value on a whole count,
    which is the likeliest place to repeat, a sample is on it with p = erf(1 / (2 sqrt(2) noise)).
    """
    if noise <= 0:
        return math.inf
    same = math.erf(0.5 / (noise * math.sqrt(2.0)))
    return math.inf if same >= 1.0 else math.ceil(math.log(FALSE_ALARM) / math.log(same))


class WatchedLink:
    """``link``, whose readings are watched. See `drivers.link.Link`.

    Args:
        link: what to watch.
        channels: channels that it delivers.
        clock: time of the session.
    """

    def __init__(self, link: Link, channels: Sequence[Channel], clock: Clock) -> None:
        self.name = link.name
        self.joints: Mapping[str, JointDrive] = link.joints
        self._link = link
        self._clock = clock
        self._watches = {channel.name: _ChannelWatch(channel) for channel in channels}
        self._open: set[tuple[str, str]] = set()
        self._restarted: set[str] = set()
        self._look_ns: int | None = None

    def open(self) -> None:
        """Open the port; see `drivers.link.Link.open`."""
        self._link.open()

    def check(self) -> tuple[DeviceStatus, ...]:
        """Ask every device who it is; see `drivers.link.Link.check`."""
        return self._link.check()

    def start(self, sample_hz: float) -> None:
        """Begin to sample, and to watch; see `drivers.link.Link.start`."""
        self._link.start(sample_hz)
        now_ns = self._clock.now_ns()
        silent_ns = round(max(SILENT_S, SILENT_PERIODS / sample_hz) * SECOND)
        for watch in self._watches.values():
            watch.begin(now_ns, silent_ns)
        self._look_ns = now_ns + LOOK_NS

    def pump(self, timeout_s: float) -> Sequence[Event]:
        """Serve the port, and look at what came; see `drivers.link.Link.pump`."""
        events = self._link.pump(timeout_s)
        found: list[Fault] = []
        for event in events:
            if isinstance(event, Reading):
                watch = self._watches.get(event.channel)
                if watch is not None:
                    if self._restarted:
                        found += self._goes_on(watch.device, event.time_ns)
                    found += watch.take(event, bool(self._open) and self._explained(watch))
            elif isinstance(event, Fault):
                self._note(event)
        if self._look_ns is not None and (now_ns := self._clock.now_ns()) >= self._look_ns:
            found += self._look(now_ns)
        return [*events, *found] if found else events

    def losses(self) -> Mapping[str, Losses]:
        """Losses of each channel; see `drivers.link.Link.losses`."""
        return self._link.losses()

    def stop(self) -> None:
        """End sampling, and watching."""
        self._look_ns = None
        self._link.stop()

    def close(self) -> None:
        """Let the port go."""
        self._link.close()

    def _look(self, now_ns: int) -> list[Fault]:
        self._look_ns = now_ns + LOOK_NS
        losses = self._link.losses()
        found = []
        for name, watch in self._watches.items():
            balance = losses.get(name)
            lost = 0 if balance is None else balance.dropped_by_device + balance.lost_in_gaps
            found += watch.look(lost, now_ns, self._explained(watch))
        return found

    def _goes_on(self, device: str, time_ns: int) -> list[Fault]:
        """A device that has restarted and needs no setting up is well with its next reading."""
        if device not in self._restarted:
            return []
        fault = Fault(time_ns, device, FaultKind.STARTED, f"{device} goes on")
        self._note(fault)
        return [fault]

    def _note(self, fault: Fault) -> None:
        if fault.kind in ENDED_BY:
            self._open.add((fault.source, fault.kind))
            for watch in self._watches.values():
                if fault.source in (watch.device, self.name):
                    watch.excuse()
        else:
            ended = [
                key
                for key in self._open
                if key[0] == fault.source and ENDED_BY[key[1]] == fault.kind
            ]
            self._open.difference_update(ended)
        if fault.kind == FaultKind.RESTARTED:
            self._restarted.add(fault.source)
        elif fault.kind == FaultKind.STARTED:
            self._restarted.discard(fault.source)
        if fault.kind in (FaultKind.RESTARTED, FaultKind.REOPENED):
            for watch in self._watches.values():
                if fault.source in (watch.device, self.name):
                    watch.forget_counter()

    def _explained(self, watch: _ChannelWatch) -> bool:
        return any(source in (watch.device, self.name) for source, _ in self._open)


class _ChannelWatch:
    """One channel: what its last readings were, and which faults of it are open."""

    def __init__(self, channel: Channel) -> None:
        self.device = channel.device or channel.name
        self._name = channel.name
        self._allowed = repeats_allowed(channel.noise)
        self._silence = SilenceWatch(None)
        self._raw: int | None = None
        self._repeats = 0
        self._same_since_ns = 0
        self._stale_since_ns: int | None = None
        self._stuck = False
        self._lost = 0
        self._losing_from: int | None = None
        self._lost_ns = 0
        self._sequence: int | None = None
        self._went_back: tuple[int, int, int] | None = None
        self._excused = False

    def begin(self, now_ns: int, silent_ns: int) -> None:
        """Sampling begins."""
        self._silence.timeout_ns = silent_ns
        self._silence.begin(now_ns)

    def take(self, reading: Reading, explained: bool) -> list[Fault]:
        """Look at a reading."""
        found = []
        if self._silence.hear(reading.time_ns):
            found.append(self._fault(reading.time_ns, FaultKind.ANSWERING, "delivers again"))
        found += self._take_value(reading)
        if reading.sequence is not None:
            found += self._take_counter(reading.sequence, reading.time_ns, explained)
        return found

    def look(self, lost: int, now_ns: int, explained: bool) -> list[Fault]:
        """Look at how much is lost by now, and whether anything comes."""
        if self._excused and not explained:
            # What was lost in the end of an outage belongs to it; from now on it counts anew.
            self._excused = False
            self._lost = lost
            if self._silence.expects:
                self._silence.begin(now_ns)
        found = self._look_at_losses(lost, now_ns, explained)
        if explained:
            return found
        if self._silence.timeout_ns is not None and self._silence.falls_silent(now_ns):
            text = f"has delivered nothing for {self._silence.timeout_ns / SECOND:g} s"
            found.append(self._fault(now_ns, FaultKind.SILENT, text))
        return found

    def excuse(self) -> None:
        """Its port or device has a fault that explains what is missing."""
        self._excused = True

    def forget_counter(self) -> None:
        """The device has restarted, and it has been said."""
        self._sequence = self._went_back = None

    def _take_value(self, reading: Reading) -> list[Fault]:
        now_ns = reading.time_ns
        flags = reading.flags
        stale = flags is not ReadingFlag.NONE and bool(flags & ReadingFlag.STALE)
        if not stale:
            self._stale_since_ns = None
        elif self._stale_since_ns is None:
            self._stale_since_ns = now_ns
        if reading.raw != self._raw:
            self._raw, self._repeats, self._same_since_ns = reading.raw, 0, now_ns
        else:
            self._repeats += 1
        repeated = self._repeats >= self._allowed and _s(now_ns - self._same_since_ns) >= STUCK_S
        old = self._stale_since_ns is not None and _s(now_ns - self._stale_since_ns) >= STUCK_S
        if self._stuck == (repeated or old):
            return []
        self._stuck = repeated or old
        if not self._stuck:
            return [self._fault(now_ns, FaultKind.CHANGING, "measures again")]
        if old:
            text = f"has given the same sample for {STUCK_S:g} s, by its counter"
        else:
            text = f"has given the count {reading.raw} {self._repeats + 1} times in a row, which its noise rules out"
        return [self._fault(now_ns, FaultKind.STUCK, text)]

    def _take_counter(self, sequence: int, now_ns: int, explained: bool) -> list[Fault]:
        last, self._sequence = self._sequence, sequence
        if last is None or sequence == last:
            return []
        if (sequence - last) % (1 << 32) >= HALF_COUNTER:
            self._went_back = (last, sequence, 0)
            return []
        if self._went_back is None:
            return []
        before, after, confirmed = self._went_back
        if sequence >= before:
            self._went_back = None
            return []
        self._went_back = (before, after, confirmed + 1)
        if confirmed + 1 < CONFIRMING:
            return []
        self._went_back = None
        if explained:
            return []
        text = f"{self.device} has restarted: its sample counter went from {before} to {after}"
        return [
            Fault(now_ns, self.device, FaultKind.RESTARTED, text),
            Fault(now_ns, self.device, FaultKind.STARTED, f"{self.device} goes on"),
        ]

    def _look_at_losses(self, lost: int, now_ns: int, explained: bool) -> list[Fault]:
        grown, self._lost = lost - self._lost, lost
        if grown > 0:
            self._lost_ns = now_ns
            if self._losing_from is None and not explained:
                self._losing_from = lost - grown
                text = f"is losing readings: {grown} in the last {_s(LOOK_NS):g} s"
                return [self._fault(now_ns, FaultKind.LOSING, text)]
        elif self._losing_from is not None and _s(now_ns - self._lost_ns) >= COMPLETE_S:
            missing = lost - self._losing_from
            text = (
                f"is complete again, after {missing} lost readings"
                if missing > 0
                else "is complete again: what seemed lost came late"
            )
            self._losing_from = None
            return [self._fault(now_ns, FaultKind.COMPLETE, text)]
        return []

    def _fault(self, time_ns: int, kind: FaultKind, text: str) -> Fault:
        return Fault(time_ns, self._name, kind, f"channel {self._name} {text}")


def _s(nanoseconds: int) -> float:
    return nanoseconds / SECOND
