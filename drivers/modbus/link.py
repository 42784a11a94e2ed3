"""The link of a Modbus line, serial or TCP: polls its devices on a schedule, supervises the port.

Each instant of the schedule polls every device once, in the order of the rig. A device that
does not answer costs the others the time of its timeout; instants that pass meanwhile are
counted as its own losses, and as a gap of the others.

When the port goes away, it is opened again after growing delays (0.25 s to 4 s), and the
samples that were due meanwhile are counted as lost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

from drivers.babble import Babble, BabbleWatch
from drivers.errors import DeviceRefused, DeviceSilent, LinkBroken, Malformed, OptionError
from drivers.identity import Identity, status_of
from drivers.link import Clock, DeviceStatus, JointDrive, Losses
from drivers.modbus.line import BITS_PER_CHARACTER, Line, RtuLine
from drivers.modbus.tcp_line import TcpLine
from drivers.port_link import PortLink
from drivers.round_trips import RoundTrips
from drivers.schedule import SECOND, Schedule
from drivers.tally import Tally
from drivers.waiting import LONGEST_WAIT_S
from recordings.events import Event
from recordings.faults import FaultKind
from recordings.rig import SerialPort, TcpPort


class PolledDevice(Protocol):
    """A device that answers when it is asked.

    Attributes:
        name: device name of the rig.
        driver: driver name.
        unit_id: Modbus address.
        tallies: of the channels that it delivers, by name.
    """

    name: str
    driver: str
    unit_id: int
    tallies: Mapping[str, Tally]

    @property
    def channels(self) -> Sequence[str]:
        """Channels that it delivers."""
        ...

    def identify(self, line: Line) -> Identity:
        """Ask it who it is; raises DriverError where it does not answer."""
        ...

    def poll(self, line: Line) -> Sequence[Event]:
        """Ask for one reading of each channel, and count it; raises DriverError, then there are none."""
        ...


LARGEST_SERIAL_UNIT = 247

BABBLE = 0.1
"""Share of the line that bytes which are nobody's reply may take before they are called babble."""


class ModbusLink(PortLink):
    """All Modbus devices of one port. See `drivers.link.Link`.

    Raises:
        OptionError: two devices have one unit id, whose replies could not be told apart; or it
            is none for this kind of port.
    """

    def __init__(
        self,
        port: SerialPort | TcpPort,
        devices: Sequence[PolledDevice],
        clock: Clock,
        connect: Callable[[Any], Any] | None = None,
    ) -> None:
        _check_units(port, devices)
        self.joints: Mapping[str, JointDrive] = {}
        self._devices = tuple(devices)
        self._line = _line(port, clock, connect)
        self._tallies = {name: tally for d in devices for name, tally in d.tallies.items()}
        super().__init__(port.name, self._line, clock, self._tallies.values())
        self._failing: set[str] = set()
        self._round_trips = {device.name: RoundTrips(device.name) for device in devices}
        self._schedule: Schedule | None = None
        self._late = self._foreign = self._noise = 0
        # Without a baud rate (TCP) there is no noise either: what makes no sense ends the connection.
        baudrate = port.baudrate if isinstance(port, SerialPort) else 0
        babble = Babble(
            source=port.name,
            where="line",
            what="bytes a second that are nobody's reply",
            cause="a device babbles, or baud rate or parity differ",
        )
        self._babble = BabbleWatch(babble, BABBLE * baudrate / BITS_PER_CHARACTER)

    def check(self) -> tuple[DeviceStatus, ...]:
        """Ask all devices, one after another, who they are; raises LinkClosed."""
        self._require_open()
        return tuple(
            status_of(device, self.name, partial(self._identify, device))
            for device in self._devices
        )

    def start(self, sample_hz: float) -> None:
        """Begin to poll; raises LinkClosed."""
        self._require_open()
        with self._turn:
            self._schedule = Schedule(sample_hz, self._clock.now_ns())

    def losses(self) -> Mapping[str, Losses]:
        """Losses of each channel, in step with the readings that `pump` has returned."""
        with self._turn:
            return {name: tally.losses() for name, tally in self._tallies.items()}

    def stop(self) -> None:
        """End polling."""
        with self._turn:
            self._end_sampling()

    def _end_sampling(self) -> None:
        self._schedule = None

    def _serve(self, timeout_s: float) -> None:
        now_ns = self._clock.now_ns()
        self._pending.extend(self._throttle.due(now_ns))
        if self._outage.lasts:
            missed = self._schedule.due(now_ns) if self._schedule is not None else 0
            reopened = self._outage.serve(missed, timeout_s)
            if reopened is not None:
                self._pending.append(reopened)
            return
        if self._schedule is None:
            self._closing.wait(min(timeout_s, LONGEST_WAIT_S))
            return
        if now_ns < self._schedule.next_ns:
            self._closing.wait(min(timeout_s, (self._schedule.next_ns - now_ns) / SECOND))
            now_ns = self._clock.now_ns()
        if instants := self._schedule.due(now_ns):
            self._poll_all(instants)
        self._pending.extend(self._babble.look(now_ns))

    def _poll_all(self, instants: int) -> None:
        for device in self._devices:
            for tally in device.tallies.values():
                _ask(tally, instants, failing=device.name in self._failing)
        for device in self._devices:
            try:
                self._poll(device)
            except LinkBroken as error:
                self._pending.append(self._outage.begin(error, sampling=True))
                return

    def _poll(self, device: PolledDevice) -> None:
        asked_ns = self._clock.now_ns()
        try:
            readings = device.poll(self._line)
        except (DeviceSilent, DeviceRefused) as error:
            kind = FaultKind.SILENT if isinstance(error, DeviceSilent) else FaultKind.REFUSED
            if device.name not in self._failing:
                self._failing.add(device.name)
                self.fault(self._clock.now_ns(), device.name, kind, f"{device.name}: {error}")
        except Malformed as error:
            self.fault(
                self._clock.now_ns(), device.name, FaultKind.MALFORMED, f"{device.name}: {error}"
            )
        else:
            if device.name in self._failing:
                self._failing.discard(device.name)
                self.fault(
                    self._clock.now_ns(),
                    device.name,
                    FaultKind.ANSWERING,
                    f"{device.name} answers again",
                )
            self._pending.extend(readings)
            for reading in readings[:1]:
                trips = self._round_trips[device.name]
                self._pending.extend(trips.answered(asked_ns, reading.time_ns))
        for tally in device.tallies.values():
            tally.give_up()
        if self._line.late > self._late:
            text = f"{device.name}: a reply came after its request was given up; it was discarded"
            self.fault(self._clock.now_ns(), device.name, FaultKind.LATE, text)
            self._late = self._line.late
        if self._line.foreign > self._foreign:
            text = f"a reply of another unit came to a request to {device.name}; it was passed over"
            self.fault(self._clock.now_ns(), self.name, FaultKind.FOREIGN, text)
            self._foreign = self._line.foreign
        self._babble.hear(self._line.noise - self._noise)
        self._noise = self._line.noise

    def _identify(self, device: PolledDevice) -> Identity:
        with self._turn:
            return device.identify(self._line)


def _ask(tally: Tally, instants: int, *, failing: bool) -> None:
    """Count the instants that have come: one is polled; the device that failed lost the others."""
    if instants > 1 and not failing:
        tally.skip(instants - 1)
        instants = 1
    tally.ask(instants)


def _line(port: SerialPort | TcpPort, clock: Clock, connect: Callable[[Any], Any] | None) -> Line:
    """The line of a port; ``connect`` opens it in place of the line's own way."""
    given = {} if connect is None else {"connect": connect}
    return (
        TcpLine(port, clock, **given)
        if isinstance(port, TcpPort)
        else RtuLine(port, clock, **given)
    )


def _check_units(port: SerialPort | TcpPort, devices: Sequence[PolledDevice]) -> None:
    units: dict[int, str] = {}
    for device in devices:
        if isinstance(port, SerialPort) and not 1 <= device.unit_id <= LARGEST_SERIAL_UNIT:
            raise OptionError(
                f"device '{device.name}': 'unit_id' is {device.unit_id}, expected 1 to "
                f"{LARGEST_SERIAL_UNIT} on a serial line"
            )
        if device.unit_id in units:
            raise OptionError(
                f"'{units[device.unit_id]}' and '{device.name}' on port '{port.name}' both have "
                f"unit_id = {device.unit_id}; unit ids must differ"
            )
        units[device.unit_id] = device.name
