"""The link of a CANopen bus: bus master, sampling by SYNC, supervision of the port.

Wire contract, beside that of the devices:

    SYNC       0x080, no data    sent at the sample rate on a schedule without drift, while sampling
    NMT        0x000  01 id      each node of the rig is started, no other
    heartbeat  0x700 + master_id  05   every 0.1 s while the bus is served and a drive wants it
    EMCY       0x080 + id        error code, 2 bytes little-endian: an EMERGENCY fault
    boot-up    0x700 + id  00    a RESTARTED fault; the node is set up again

Who serves the bus: one thread at a time holds the turn. `pump` takes it; so does whoever
waits for an SDO answer while nobody else has it. So commands work from any thread, with or
without a pump running, and the link needs no thread of its own.

When the port goes away, it is opened again after growing delays (0.25 s to 4 s), and the
samples that were due meanwhile are counted as lost.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from canopen import Network
from canopen.emcy import EmcyError

from drivers.can_bus import Bus, CanBus, Frame, connect
from drivers.canopen.device import CanopenDevice
from drivers.canopen.node_ids import master_id_of
from drivers.canopen.sdo import SDO_LENGTH, Sdo
from drivers.errors import DriverError, LinkBroken, LinkClosed, Malformed
from drivers.faults import FaultKind, FaultThrottle
from drivers.link import Clock, DeviceStatus, JointDrive, Losses
from drivers.outage import LONGEST_WAIT_S, Outage
from drivers.schedule import SECOND, Backoff, Schedule
from recordings.events import Event, Fault, Reading
from recordings.rig import CanPort

MOST_FRAMES = 256
"""Most frames taken in one turn, so that what is due gets sent on a flooded bus."""

HEARTBEAT_HZ = 10.0
LAST_ANSWERS_S = 0.1
NMT, SYNC, EMCY, SDO_ANSWER, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x700
NMT_START, OPERATIONAL = 0x01, 0x05


class _Network(Network):
    """The package's network, sending through our bus."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(can_id, bytes(data))


class CanopenLink:
    """All CANopen devices of one port. See `drivers.link.Link`.

    Raises:
        OptionError: two devices have one node id, or drives disagree about the master's.
    """

    def __init__(
        self,
        port: CanPort,
        devices: Sequence[CanopenDevice],
        clock: Clock,
        connect: Callable[[CanPort], Bus] = connect,
    ) -> None:
        self.name = port.name
        self.joints: Mapping[str, JointDrive] = {
            device.drive.joint: device.drive for device in devices if device.drive is not None
        }
        self._devices = tuple(devices)
        self._master_id = master_id_of(port.name, self._devices)
        self._clock = clock
        self._bus = CanBus(port, clock, connect)
        self._network = _Network(self.send)
        self._by_cob_id = {i: device for device in devices for i in device.cob_ids}
        self._by_node_id = {device.node_id: device for device in devices}
        self._tallies = {name: tally for d in devices for name, tally in d.tallies.items()}
        self._turn = threading.Lock()
        self._sending = threading.Lock()
        self._closing = threading.Event()
        self._closing.set()
        self._pending: deque[Event] = deque()
        self._throttle = FaultThrottle()
        self._heartbeat: Schedule | None = None
        self._schedule: Schedule | None = None
        self._started = False
        self._outage = Outage(port.name, self._bus, self._tallies.values(), clock, self._closing)
        self._unready: dict[CanopenDevice, Backoff | None] = {}
        self._counted: Counter[FaultKind] = Counter()
        for device in devices:
            device.attach(self)

    def open(self) -> None:
        """Open the port; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        with self._turn:
            self._bus.open()
            self._outage.end()
            self._heartbeat = Schedule(HEARTBEAT_HZ, self._clock.now_ns())
            self._closing.clear()

    def check(self) -> tuple[DeviceStatus, ...]:
        """Ask all devices at once who they are; raises LinkClosed."""
        self._require_open()
        if not self._devices:
            return ()
        with ThreadPoolExecutor(len(self._devices), f"{self.name}-check") as pool:
            return tuple(pool.map(self._check, self._devices))

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
            events = list(self._pending)
            self._pending.clear()
        return events

    def losses(self) -> Mapping[str, Losses]:
        """Losses of each channel, in step with the readings that `pump` has returned."""
        with self._turn:
            waiting = Counter(e.channel for e in self._pending if isinstance(e, Reading))
            balances = {name: tally.losses() for name, tally in self._tallies.items()}
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
            self._schedule = None
            self._started = False
            deadline = time.monotonic() + LAST_ANSWERS_S
            while (
                any(tally.under_way for tally in self._tallies.values())
                and (left := deadline - time.monotonic()) > 0
                and not self._closing.is_set()
            ):
                self._serve(left)
            for tally in self._tallies.values():
                tally.give_up()

    def close(self) -> None:
        """Let the port go. Drives that heed the master's heartbeat fall into their safe state."""
        self._closing.set()
        with self._turn:
            self._schedule = None
            self._started = False
            self._bus.close()

    def now_ns(self) -> int:
        """Time of the session."""
        return self._clock.now_ns()

    def send(self, cob_id: int, data: bytes) -> None:
        """Send a frame; raises LinkBroken or LinkClosed."""
        self._require_present()
        with self._sending:
            self._bus.send(cob_id, data)

    def sdo(self, node_id: int) -> Sdo:
        """Access to the object dictionary of a node."""
        return Sdo(self._network, node_id, self._await_answer)

    def _await_answer(self, answers: queue.Queue[bytes], timeout_s: float) -> bytes:
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            self._require_present()
            if not answers.empty():
                break
            slice_s = min(left, LONGEST_WAIT_S)
            if self._turn.acquire(blocking=False):
                try:
                    if answers.empty():
                        self._serve(slice_s)
                finally:
                    self._turn.release()
            else:
                try:
                    return answers.get(timeout=slice_s)
                except queue.Empty:
                    continue
        return answers.get_nowait()

    def _serve(self, timeout_s: float) -> None:
        """One turn: send what is due, wait for a frame, take all that are there."""
        now_ns = self._clock.now_ns()
        self._pending.extend(self._throttle.due(now_ns))
        if self._outage.lasts:
            self._serve_outage(now_ns, timeout_s)
            return
        try:
            self._send_due(now_ns)
            wait_s = self._wait_s(timeout_s)
            for _ in range(MOST_FRAMES):
                frame = self._bus.receive(wait_s)
                self._report_counts()
                if frame is None:
                    break
                self._take(frame)
                wait_s = 0.0
        except LinkBroken as error:
            sampling = self._schedule is not None
            self._pending.append(self._outage.begin(error, sampling=sampling))

    def _serve_outage(self, now_ns: int, timeout_s: float) -> None:
        missed = self._schedule.due(now_ns) if self._schedule is not None else 0
        reopened = self._outage.serve(missed, timeout_s)
        if reopened is not None:
            self._pending.append(reopened)
            if self._started:
                self._unready.update(dict.fromkeys(self._devices))

    def _send_due(self, now_ns: int) -> None:
        if self._heartbeat is not None and self._heartbeat.due(now_ns) and self._master_id:
            self.send(HEARTBEAT + self._master_id, bytes([OPERATIONAL]))
        if self._schedule is None or not (instants := self._schedule.due(now_ns)):
            return
        for tally in self._tallies.values():
            if instants > 1:
                tally.skip(instants - 1)
            tally.ask()
        if self._tallies:
            self.send(SYNC, b"")
        for device in self._devices:
            self._pending.extend(device.sync(now_ns))

    def _wait_s(self, timeout_s: float) -> float:
        wait_s = min(timeout_s, LONGEST_WAIT_S)
        for schedule in (self._heartbeat, self._schedule):
            if schedule is not None:
                wait_s = min(wait_s, (schedule.next_ns - self._clock.now_ns()) / SECOND)
        return max(wait_s, 0.0)

    def _take(self, frame: Frame) -> None:
        function, node_id = frame.cob_id & 0x780, frame.cob_id & 0x7F
        device = self._by_cob_id.get(frame.cob_id)
        node = self._by_node_id.get(node_id)
        try:
            if device is not None:
                self._pending.extend(device.receive(frame))
            elif function == SDO_ANSWER and len(frame.data) == SDO_LENGTH:
                self._network.notify(frame.cob_id, bytearray(frame.data), frame.time_ns / SECOND)
            elif node is not None and function == EMCY:
                self._take_emergency(node, frame)
            elif node is not None and function == HEARTBEAT and frame.data[:1] == b"\0":
                self._take_boot_up(node, frame)
        except Malformed as error:
            source = (device or node or self).name
            self._fault(frame.time_ns, source, FaultKind.MALFORMED, str(error))

    def _take_emergency(self, node: CanopenDevice, frame: Frame) -> None:
        if len(frame.data) < 2:
            raise Malformed(f"an EMCY of {len(frame.data)} bytes, expected 8")
        code = int.from_bytes(frame.data[:2], "little")
        if code >> 8:
            meaning = EmcyError(code, 0, b"", 0.0).get_desc() or "unknown"
            text = f"{node.name} reports the error 0x{code:04X} ({meaning})"
            self._fault(frame.time_ns, node.name, FaultKind.EMERGENCY, text)
        self._pending.extend(node.emergency(code, frame.time_ns))

    def _take_boot_up(self, node: CanopenDevice, frame: Frame) -> None:
        node.restarted()
        if not self._started:
            return
        text = f"{node.name} has restarted by itself; it is set up again"
        self._fault(frame.time_ns, node.name, FaultKind.RESTARTED, text)
        self._unready[node] = None

    def _report_counts(self) -> None:
        for kind, count, text in (
            (FaultKind.MALFORMED, self._bus.malformed, "a frame came garbled from the adapter"),
            (FaultKind.BUS_ERROR, self._bus.error_frames, "the CAN controller reports a bus error"),
        ):
            for _ in range(count - self._counted[kind]):
                self._fault(self._clock.now_ns(), self.name, kind, text)
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

    def _retry_later(
        self, device: CanopenDevice, backoff: Backoff | None, error: DriverError
    ) -> None:
        now_ns = self._clock.now_ns()
        if backoff is None:
            backoff = Backoff(now_ns)
        else:
            backoff.failed(now_ns)
        self._unready[device] = backoff
        with self._turn:
            self._fault(now_ns, device.name, FaultKind.NOT_STARTED, str(error))

    def _fault(self, time_ns: int, source: str, kind: FaultKind, text: str) -> None:
        self._pending.extend(self._throttle.offer(Fault(time_ns, source, kind, text)))

    def _check(self, device: CanopenDevice) -> DeviceStatus:
        channels = tuple(device.tallies)
        try:
            identity = device.identify()
        except DriverError as error:
            return DeviceStatus(
                device.name, device.driver, self.name, channels, answers=False, problem=str(error)
            )
        return DeviceStatus(
            name=device.name,
            driver=device.driver,
            port=self.name,
            channels=channels,
            answers=True,
            identity=identity.text,
            virtual=identity.virtual,
            problem=identity.problem,
        )

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise LinkClosed(f"port '{self.name}' is not open; call open() first")

    def _require_present(self) -> None:
        self._require_open()
        if self._outage.lasts:
            raise LinkBroken(f"port '{self.name}' is gone; it is being opened again")
