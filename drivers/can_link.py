"""The link of a CAN bus: serves devices of any CAN protocol, supervises the port.

Wire contract: that of the devices, and of their services (`drivers.can_device`). On a port with
``listen_only`` nothing is ever sent, and a device that needs sending is refused.

Who serves the bus: one thread at a time holds the turn. `pump` takes it; so does whoever
waits for an answer while nobody else has it. So commands work from any thread, with or
without a pump running, and the link needs no thread of its own.

When the port goes away, it is opened again after growing delays (0.25 s to 4 s), and the
samples that were due meanwhile are counted as lost.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from drivers.babble import Babble, BabbleWatch
from drivers.can_bus import Bus, CanBus, Frame, connect
from drivers.can_device import CanDevice, CanParticipant, CanService, TakesBlocks
from drivers.errors import DriverError, LinkBroken, Malformed, OptionError
from drivers.identity import status_of
from drivers.link import Clock, DeviceStatus, JointDrive, Losses
from drivers.port_link import PortLink
from drivers.schedule import SECOND, Backoff, Schedule
from drivers.waiting import LONGEST_WAIT_S, waits
from recordings.events import Event, Fault, Reading
from recordings.faults import FaultKind
from recordings.rig import CanPort

MOST_FRAMES = 256
"""Most frames taken in one turn, so that what is due gets sent on a flooded bus."""

FEW_FRAMES = 16
"""Fewer than these are not worth sorting."""

LAST_ANSWERS_S = 0.1

BITS_PER_FRAME = 125
"""Of a frame of 8 bytes, stuffing and the space between frames included."""

BABBLE = 0.5
"""Share of the bus that frames which nobody wants may take before they are called babble."""


class CanLink(PortLink):
    """All devices of one CAN port. See `drivers.link.Link` and `drivers.can_device.CanWire`.

    Raises:
        OptionError: the port listens only, and a device needs sending; or what a service says.
    """

    def __init__(
        self,
        port: CanPort,
        devices: Sequence[CanDevice],
        clock: Clock,
        connect: Callable[[CanPort], Bus] = connect,
    ) -> None:
        self._bus = CanBus(port, clock, connect)
        self._tallies = {name: tally for d in devices for name, tally in d.tallies.items()}
        super().__init__(port.name, self._bus, clock, self._tallies.values())
        self.joints: Mapping[str, JointDrive] = {
            device.drive.joint: device.drive for device in devices if device.drive is not None
        }
        self._devices = tuple(devices)
        _refuse_senders(port, self._devices)
        self._services = _services(port.name, self._devices)
        self._participants: tuple[CanParticipant, ...] = (*self._services, *self._devices)
        self._takers: dict[int, list[CanParticipant]] = {}
        for participant in self._participants:
            for identifier in participant.identifiers:
                self._takers.setdefault(identifier, []).append(participant)
        self._blocks = {
            identifier: takers[0]
            for identifier, takers in self._takers.items()
            if len(takers) == 1 and isinstance(takers[0], TakesBlocks)
        }
        self._sending = threading.Lock()
        self._schedule: Schedule | None = None
        self._started = False
        self._unready: dict[CanDevice, Backoff | None] = {}
        self._not_set_up: set[CanDevice] = set()
        babble = Babble(
            source=port.name,
            where="bus",
            what="frames a second that no device of the rig sends",
            cause="a device babbles, or the bus is shared with too much else",
        )
        self._babble = BabbleWatch(babble, BABBLE * port.bitrate / BITS_PER_FRAME)
        self._counted: Counter[FaultKind] = Counter()
        self._reported = (0, 0)
        for service in self._services:
            service.attach(self)
        for device in devices:
            if device.service is None:
                device.attach(self)

    def check(self) -> tuple[DeviceStatus, ...]:
        """Ask all devices at once who they are; raises LinkClosed."""
        self._require_open()
        if not self._devices:
            return ()
        with ThreadPoolExecutor(len(self._devices), f"{self.name}-check") as pool:
            return tuple(
                pool.map(lambda each: status_of(each, self.name, each.identify), self._devices)
            )

    def start(self, sample_hz: float) -> None:
        """Set up all devices, then sample; raises DeviceSilent, DeviceRefused or LinkBroken."""
        self._require_open()
        for device in self._devices:
            device.start()
        with self._turn:
            self._started = True
            self._unready.clear()
            self._schedule = Schedule(sample_hz, self._clock.now_ns())

    def pump(self, timeout_s: float) -> Sequence[Event]:
        """Serve the bus for one turn; raises LinkClosed."""
        self._require_open()
        if not self._pending:
            with self._turn:
                self._serve(timeout_s)
        self._set_up_again()
        with self._turn:
            return self._taken()

    def losses(self) -> Mapping[str, Losses]:
        """Losses of each channel, in step with the readings that `pump` has returned."""
        with self._turn:
            waiting = Counter(e.channel for e in self._pending if isinstance(e, Reading))
            now_ns = self._clock.now_ns()
            balances = {n: ls for d in self._devices for n, ls in d.losses(now_ns).items()}
        return {
            name: Losses(
                expected=losses.expected - waiting[name],
                dropped_by_device=losses.dropped_by_device,
                lost_in_gaps=losses.lost_in_gaps,
                gaps=losses.gaps,
            )
            for name, losses in balances.items()
        }

    def stop(self) -> None:
        """End sampling, having waited shortly for answers under way."""
        with self._turn:
            self._end_sampling()
            for wait_s in waits(LAST_ANSWERS_S):
                if self._closing.is_set() or not self._is_answer_under_way():
                    break
                self._serve(wait_s)
            for tally in self._tallies.values():
                tally.give_up()
            for device in self._devices:
                device.stop(self._clock.now_ns())

    def now_ns(self) -> int:
        """Time of the session."""
        return self._clock.now_ns()

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame; raises LinkBroken or LinkClosed."""
        self._require_present()
        with self._sending:
            self._bus.send(identifier, data)

    def await_answer(self, answers: queue.Queue[bytes], timeout_s: float) -> bytes:
        """See `drivers.can_device.CanWire.await_answer`."""
        for wait_s in waits(timeout_s):
            self._require_present()
            if not answers.empty():
                break
            if self._turn.acquire(blocking=False):
                try:
                    if answers.empty():
                        self._serve(wait_s)
                finally:
                    self._turn.release()
            else:
                with contextlib.suppress(queue.Empty):
                    return answers.get(timeout=wait_s)
        return answers.get_nowait()

    def is_wanted(self, identifier: int) -> bool:
        """See `drivers.can_device.CanWire.is_wanted`."""
        return any(identifier in device.identifiers for device in self._devices)

    def restarted(self, device: CanDevice) -> None:
        """Set ``device`` up again, if it had been started; called in a turn."""
        if not self._started:
            return
        text = f"{device.name} has restarted by itself; it is set up again"
        self.fault(self._clock.now_ns(), device.name, FaultKind.RESTARTED, text)
        self._unready[device] = None
        self._not_set_up.add(device)

    def _is_answer_under_way(self) -> bool:
        return any(tally.under_way for tally in self._tallies.values())

    def _opened(self) -> None:
        for service in self._services:
            service.open(self._clock.now_ns())

    def _end_sampling(self) -> None:
        self._schedule = None
        self._started = False

    def _serve(self, timeout_s: float) -> None:
        """One turn: send what is due, wait for a frame, take all that are there."""
        now_ns = self._clock.now_ns()
        self._pending.extend(self._throttle.due(now_ns))
        if self._outage.lasts:
            self._serve_outage(now_ns, timeout_s)
            return
        try:
            self._pending.extend(self._babble.look(now_ns))
            self._send_due(now_ns)
            wait_s = self._wait_s(timeout_s)
            taken = 0
            while taken < MOST_FRAMES:
                frames = self._bus.receive_all(wait_s, MOST_FRAMES)
                self._report_counts()
                if not frames:
                    break
                self._take_all(frames)
                taken += len(frames)
                wait_s = 0.0
        except LinkBroken as error:
            sampling = self._schedule is not None
            self._pending.append(self._outage.begin(error, sampling=sampling))
            for device in self._devices:
                device.interrupt()

    def _serve_outage(self, now_ns: int, timeout_s: float) -> None:
        missed = self._schedule.due(now_ns) if self._schedule is not None else 0
        reopened = self._outage.serve(missed, timeout_s)
        if reopened is not None:
            self._pending.append(reopened)
            if self._started:
                self._unready.update(dict.fromkeys(self._devices))

    def _send_due(self, now_ns: int) -> None:
        for participant in self._participants:
            self._pending.extend(participant.serve(now_ns))
        if self._schedule is None or not (instants := self._schedule.due(now_ns)):
            return
        for tally in self._tallies.values():
            if instants > 1:
                tally.skip(instants - 1)
            tally.ask()
        for service in self._services:
            self._pending.extend(service.sample(now_ns))

    def _wait_s(self, timeout_s: float) -> float:
        due = [ns for each in self._participants if (ns := each.due_ns()) is not None]
        if self._schedule is not None:
            due.append(self._schedule.next_ns)
        wait_s = min(timeout_s, LONGEST_WAIT_S)
        if due:
            wait_s = min(wait_s, (min(due) - self._clock.now_ns()) / SECOND)
        return max(wait_s, 0.0)

    def _take_all(self, frames: Sequence[Frame]) -> None:
        """Take frames in their order, but those that are taken in blocks together, at the end."""
        if len(frames) < FEW_FRAMES:
            for frame in frames:
                self._take(frame)
            return
        blocks: dict[int, list[Frame]] = {}
        for frame in frames:
            if frame.identifier in self._blocks:
                blocks.setdefault(frame.identifier, []).append(frame)
            else:
                self._take(frame)
        for identifier, (first, *others) in blocks.items():
            self._take(first)
            same_moment = others and others[-1].time_ns == first.time_ns
            events = self._blocks[identifier].receive_on(others) if same_moment else None
            if events is not None:
                self._pending.extend(events)
                continue
            for frame in others:
                self._take(frame)

    def _take(self, frame: Frame) -> None:
        takers = self._takers.get(frame.identifier)
        if takers is None:
            self._babble.hear(1)
            return
        for taker in takers:
            try:
                self._pending.extend(taker.receive(frame))
            except Malformed as error:
                self.fault(frame.time_ns, taker.name, FaultKind.MALFORMED, str(error))

    def _report_counts(self) -> None:
        counts = self._bus.malformed, self._bus.error_frames
        if counts == self._reported:
            return
        self._reported = counts
        for kind, count, text in (
            (FaultKind.MALFORMED, self._bus.malformed, "a frame came garbled from the adapter"),
            (FaultKind.BUS_ERROR, self._bus.error_frames, "the CAN controller reports a bus error"),
        ):
            for _ in range(count - self._counted[kind]):
                self.fault(self._clock.now_ns(), self.name, kind, text)
            self._counted[kind] = count

    def _set_up_again(self) -> None:
        """Set up devices that an interruption left unready; those that fail are tried again later."""
        for device, backoff in list(self._unready.items()):
            now_ns = self._clock.now_ns()
            if self._outage.lasts or (backoff is not None and now_ns < backoff.next_ns):
                continue
            # Taken off the list first: it may boot once more while it is being set up.
            self._unready.pop(device, None)
            try:
                device.start()
            except LinkBroken:
                return
            except DriverError as error:
                self._retry_later(device, backoff, error)
            else:
                self._is_set_up(device)

    def _is_set_up(self, device: CanDevice) -> None:
        if device not in self._not_set_up:
            return
        self._not_set_up.discard(device)
        now_ns = self._clock.now_ns()
        with self._turn:
            # Each end is reported, however often it repeats: without it, its fault would last.
            text = f"{device.name} is set up again"
            self._pending.append(Fault(now_ns, device.name, FaultKind.STARTED, text))

    def _retry_later(self, device: CanDevice, backoff: Backoff | None, error: DriverError) -> None:
        now_ns = self._clock.now_ns()
        if backoff is None:
            backoff = Backoff(now_ns)
        else:
            backoff.failed(now_ns)
        self._unready[device] = backoff
        self._not_set_up.add(device)
        with self._turn:
            self.fault(now_ns, device.name, FaultKind.NOT_STARTED, str(error))

    def _require_present(self) -> None:
        self._require_open()
        if self._outage.lasts:
            raise LinkBroken(f"port '{self.name}' is gone; it is being opened again")


def _refuse_senders(port: CanPort, devices: Sequence[CanDevice]) -> None:
    if not port.listen_only:
        return
    for device in devices:
        if device.sends:
            raise OptionError(
                f"device '{device.name}' ({device.driver}) must be sent frames to work, but its "
                f"port '{port.name}' has listen_only = true; remove that, or use a driver that "
                f"only listens (dbc-encoder, dbc-listener, canopen-listener)"
            )


def _services(port: str, devices: Sequence[CanDevice]) -> tuple[CanService, ...]:
    """Each service that a device names, once, for all devices that name it."""
    makers = dict.fromkeys(device.service for device in devices if device.service is not None)
    return tuple(make(port, [d for d in devices if d.service == make]) for make in makers)
