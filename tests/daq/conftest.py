"""A bench without wires: links with a scripted mechanism behind them, and time that they share.

Time passes only where the session waits, and it waits until every link has delivered what
happened meanwhile: a session of minutes takes milliseconds and runs the same way each time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers import BadCommand, DeviceSilent, DeviceStatus, DriverError, Losses
from recordings.events import Event, Mode, ModeReport, Reading
from recordings.rig import Rig, load_rig, parameters, rig_text

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND


class SharedClock:
    """A manual clock that moves on only when all followers have delivered everything before."""

    def __init__(self) -> None:
        self._now_ns = START_NS
        self._delivered: dict[str, int] = {}
        self._changed = threading.Condition()

    def now_ns(self) -> int:
        return self._now_ns

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        if not event.is_set():
            with self._changed:
                self._now_ns += round(timeout_s * SECOND)
                self._changed.notify_all()
                caught_up = self._changed.wait_for(self._all_delivered, 20.0)
                assert caught_up, f"links fell behind: {self._delivered}"
        return event.is_set()

    def _all_delivered(self) -> bool:
        return all(until == self._now_ns for until in self._delivered.values())

    def follow(self, name: str) -> None:
        with self._changed:
            self._delivered[name] = self._now_ns

    def leave(self, name: str) -> None:
        with self._changed:
            self._delivered.pop(name, None)
            self._changed.notify_all()

    def after(self, name: str, until_ns: int) -> int:
        """Say that all up to ``until_ns`` is delivered; wait a little for time to go on."""
        with self._changed:
            if name in self._delivered:
                self._delivered[name] = until_ns
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._now_ns > until_ns, 0.02)
            return self._now_ns


@dataclass
class Bench:
    """The mechanism behind the links, and what was done to it.

    Attributes:
        rig: the rig.
        clock: shared time.
        values: reading of each channel that nobody drives [rad or m], as a function of seconds.
        modes: mode of each joint's drive.
        targets: target of each driven joint [counts].
        log: every mode and target command, in order.
        silent_devices: devices that do not answer.
        mute_channels: channels that never deliver.
        real_drives: whether drives say that they are not virtual.
        on_sample: called with the seconds so far at each sampling instant.
    """

    rig: Rig
    toml: str
    clock: SharedClock = field(default_factory=SharedClock)
    values: Callable[[float], Mapping[str, float]] = lambda seconds: {}
    modes: dict[str, Mode] = field(default_factory=dict)
    targets: dict[str, int] = field(default_factory=dict)
    log: list[tuple[str, Mode, int | None]] = field(default_factory=list)
    silent_devices: set[str] = field(default_factory=set)
    mute_channels: set[str] = field(default_factory=set)
    real_drives: bool = False
    stuck: set[str] = field(default_factory=set)
    on_sample: Callable[[float], None] = lambda seconds: None
    links: list[FakeLink] = field(default_factory=list)
    vouched_ns: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.modes = {d.joint: Mode.OFF for d in self.rig.devices if d.joint is not None}
        self.counts = {channel.name: float(channel.zero_count) for channel in self.rig.channels}
        self.links = [FakeLink(port.name, self) for port in self.rig.ports]

    def link(self, name: str) -> FakeLink:
        return next(link for link in self.links if link.name == name)

    def fault(self, joint: str) -> None:
        """Let the drive of ``joint`` report a fault at its next sample."""
        self.modes[joint] = Mode.FAULT

    def true_counts(self, channel: str, seconds: float, step_s: float) -> float:
        place = self.rig.channel(channel)
        if place.senses in self.targets and place.senses not in self.stuck:
            lag = self.targets[place.senses] - self.counts[channel]
            self.counts[channel] += lag * min(1.0, step_s / 0.03)
        value = self.values(seconds).get(channel)
        if value is not None:
            nominal = {p.name: p.nominal for p in parameters_of(self.rig)}
            away = (value - nominal[f"{channel}.offset"]) / nominal[f"{channel}.gain"]
            self.counts[channel] = place.zero_count + away
        return self.counts[channel]


_PARAMETERS: dict[str, Sequence] = {}


def parameters_of(rig: Rig) -> Sequence:
    if rig.name not in _PARAMETERS:
        _PARAMETERS[rig.name] = parameters(rig)
    return _PARAMETERS[rig.name]


class FakeDrive:
    """A drive that does at once what it is told."""

    def __init__(self, joint: str, bench: Bench) -> None:
        self.joint = joint
        self._bench = bench
        self.broken = False
        self.unanswered = 0

    def _answer(self) -> None:
        if self.broken or self.unanswered > 0:
            self.unanswered -= 1
            raise DeviceSilent(f"drive of {self.joint} does not answer")

    def set_mode(self, mode: Mode) -> None:
        self._answer()
        self._bench.log.append((self.joint, mode, None))
        if mode is not Mode.POSITION:
            self._bench.targets.pop(self.joint, None)
        self._bench.modes[self.joint] = mode

    def move_to(self, target_raw: int) -> None:
        self._answer()
        if self._bench.modes[self.joint] is not Mode.POSITION:
            raise BadCommand(f"{self.joint} is not in position mode")
        self._bench.log.append((self.joint, Mode.POSITION, target_raw))
        self._bench.targets[self.joint] = target_raw

    def set_torque(self, permille: int) -> None:
        raise AssertionError("no session sets a torque")

    def vouch(self, until_ns: int) -> None:
        self._bench.vouched_ns[self.joint] = until_ns

    def report(self) -> ModeReport:
        mode = self._bench.modes[self.joint]
        fault = mode is Mode.FAULT
        status, error = (0x0008, 0x8611) if fault else (0x0027, 0)
        return ModeReport(self.joint, self._bench.clock.now_ns(), mode, status, error)


class FakeLink:
    """A port with its devices, at the sampling rate of the session, in shared time."""

    def __init__(self, name: str, bench: Bench) -> None:
        self.name = name
        self._bench = bench
        self._devices = [d for d in bench.rig.devices if d.port == name]
        names = {d.name for d in self._devices}
        self._channels = [c for c in bench.rig.channels if c.device in names]
        self.joints = {d.joint: FakeDrive(d.joint, bench) for d in self._devices if d.joint}
        self._rng = np.random.default_rng(len(name))
        self._count = dict.fromkeys((c.name for c in self._channels), 0)
        self._drop = dict.fromkeys(self._count, 0)
        self._pending: list[Event] = []
        self.drop_every: int | None = None
        self.open_error: DriverError | None = None
        self.break_at_s: float | None = None
        self.break_with: Exception = RuntimeError("broken for the test")
        self.calls: list[str] = []

    def open(self) -> None:
        self.calls.append("open")
        if self.open_error is not None:
            raise self.open_error
        self._bench.clock.follow(self.name)
        self._until_ns = self._bench.clock.now_ns()

    def check(self) -> tuple[DeviceStatus, ...]:
        silent = self._bench.silent_devices
        return tuple(
            DeviceStatus(
                device.name,
                device.driver,
                self.name,
                tuple(c.name for c in self._channels if c.device == device.name),
                device.name not in silent,
                virtual=not self._bench.real_drives,
                problem="no answer in 0.2 s" if device.name in silent else "",
            )
            for device in self._devices
        )

    def start(self, sample_hz: float) -> None:
        self.calls.append("start")
        self._period_ns = round(SECOND / sample_hz)
        self._next_ns = self._until_ns + self._period_ns
        self._modes = dict.fromkeys(self.joints, Mode.UNKNOWN)

    def pump(self, timeout_s: float) -> Sequence[Event]:
        if "stop" in self.calls:
            return []
        now_ns = self._bench.clock.after(self.name, self._until_ns)
        self._until_ns = now_ns
        events: list[Event] = []
        while self._next_ns <= now_ns:
            events += self._sample(self._next_ns)
            self._next_ns += self._period_ns
        for joint, drive in self.joints.items():
            if self._modes[joint] is not self._bench.modes[joint]:
                self._modes[joint] = self._bench.modes[joint]
                events.append(drive.report())
        return events

    def _sample(self, time_ns: int) -> list[Event]:
        seconds = (time_ns - START_NS) / SECOND
        self._bench.on_sample(seconds)
        if self.break_at_s is not None and seconds >= self.break_at_s:
            self._bench.clock.leave(self.name)
            raise self.break_with
        events: list[Event] = []
        for channel in self._channels:
            if channel.name in self._bench.mute_channels:
                continue
            self._count[channel.name] += 1
            if self.drop_every and self._count[channel.name] % self.drop_every == 0:
                self._drop[channel.name] += 1
                continue
            true = self._bench.true_counts(channel.name, seconds, self._period_ns / SECOND)
            raw = round(true + channel.noise * self._rng.standard_normal())
            events.append(Reading(channel.name, time_ns, raw))
        return events

    def losses(self) -> Mapping[str, Losses]:
        return {name: Losses(self._count[name], self._drop[name], 0, 0) for name in self._count}

    def stop(self) -> None:
        self.calls.append("stop")
        self._bench.clock.leave(self.name)

    def close(self) -> None:
        self.calls.append("close")
        self._bench.clock.leave(self.name)


@pytest.fixture
def arm() -> Bench:
    """The bundled arm, with 4 poses of which 2 are visited twice."""
    return _bench("arm", poses=4, revisits=2)


@pytest.fixture
def shoulder() -> Bench:
    """The bundled shoulder, moved by hand; 3 poses of which 1 is visited twice."""
    return _bench("shoulder", poses=3, revisits=1)


def _bench(name: str, poses: int, revisits: int) -> Bench:
    rig = load_rig(name)
    revisit = rig.plan.revisit.model_copy(update={"poses": revisits, "visits": 2})
    plan = rig.plan.model_copy(update={"poses": poses, "revisit": revisit})
    return Bench(rig.model_copy(update={"plan": plan}), rig_text(name)[0])


@pytest.fixture(autouse=True)
def _no_thread_is_left() -> object:
    before = set(threading.enumerate())
    yield
    left = [t.name for t in threading.enumerate() if t not in before and t.is_alive()]
    assert not left, f"threads left behind: {left}"
