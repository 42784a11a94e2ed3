"""The link of a serial port with one streaming sensor: reads what comes, supervises the port.

Nothing is sent but ``start_text`` when sampling begins (and again after an interruption) and
``stop_text`` when it ends, where the rig gives them. All samples of one read have one time of
arrival: how far they are apart is told by the sensor's own clock, where it has one.

When the port goes away, it is opened again after growing delays (0.25 s to 4 s).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.errors import LinkBroken, OptionError
from drivers.link import Clock, DeviceStatus, JointDrive, Losses
from drivers.port_link import PortLink
from drivers.schedule import SECOND
from drivers.serial_port import Connect, SerialPort, connect
from drivers.stream.decoder import Sample
from drivers.stream.sensor import StreamSensor
from drivers.waiting import LONGEST_WAIT_S, waits
from recordings.faults import FaultKind
from recordings.rig import SerialPort as RigPort


class _Port(SerialPort):
    """The port of a sensor, whose stream begins anew, anywhere, each time that it is opened."""

    def __init__(self, port: RigPort, sensor: StreamSensor, connect: Connect) -> None:
        super().__init__(port, connect)
        self._sensor = sensor

    def open(self) -> None:
        """Open the port; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        super().open()
        self._sensor.reset()

    def say(self, text: str) -> None:
        """Send ``text``, if it is any; raises LinkBroken or LinkClosed."""
        if text:
            self.write(text.encode())


class StreamLink(PortLink):
    """The one streaming sensor of a serial port. See `drivers.link.Link`.

    Raises:
        OptionError: there are two, whose bytes could not be told apart.
    """

    def __init__(
        self,
        port: RigPort,
        devices: Sequence[StreamSensor],
        clock: Clock,
        connect: Connect = connect,
    ) -> None:
        if len(devices) != 1:
            names = " and ".join(f"'{device.name}'" for device in devices)
            raise OptionError(f"{names} both stream on port '{port.name}'; a stream has one sender")
        self.joints: Mapping[str, JointDrive] = {}
        self._sensor = devices[0]
        self._port: _Port = _Port(port, self._sensor, connect)
        super().__init__(port.name, self._port, clock)
        self._sampling = False

    def check(self) -> tuple[DeviceStatus, ...]:
        """Start the sensor and wait for a sample; raises LinkClosed."""
        self._require_open()
        with self._turn:
            problem = "" if self._sampling else self._listen()
        return (
            DeviceStatus(
                name=self._sensor.name,
                driver=self._sensor.driver,
                port=self.name,
                channels=tuple(self._sensor.channels),
                answers=not problem,
                problem=problem,
            ),
        )

    def start(self, sample_hz: float) -> None:
        """Begin to take samples, at the sensor's own rate; raises LinkBroken."""
        self._require_open()
        with self._turn:
            self._port.say(self._sensor.options.start_text)
            self._sensor.start(self._clock.now_ns())
            self._sampling = True

    def losses(self) -> Mapping[str, Losses]:
        """Losses of each channel, in step with the readings that `pump` has returned."""
        with self._turn:
            return self._sensor.losses(self._clock.now_ns())

    def stop(self) -> None:
        """End sampling."""
        with self._turn:
            if not self._sampling:
                return
            self._sampling = False
            self._sensor.stop(self._clock.now_ns())
            if not self._outage.lasts and not self._closing.is_set():
                try:
                    self._port.say(self._sensor.options.stop_text)
                except LinkBroken as error:
                    self._pending.append(self._outage.begin(error, sampling=False))

    def _end_sampling(self) -> None:
        self._sampling = False

    def _serve(self, timeout_s: float) -> None:
        now_ns = self._clock.now_ns()
        self._pending.extend(self._throttle.due(now_ns))
        try:
            if self._outage.lasts:
                self._serve_outage(timeout_s)
                return
            data = self._port.read(min(timeout_s, LONGEST_WAIT_S))
        except LinkBroken as error:
            self._sensor.interrupt()
            self._pending.append(self._outage.begin(error, sampling=self._sampling))
            return
        time_ns = self._clock.now_ns()
        for item in self._sensor.samples(data) if data else ():
            self._take(item, time_ns)
        if self._sampling:
            self._pending.extend(self._sensor.silence(self._clock.now_ns()))

    def _take(self, item: Sample | str, time_ns: int) -> None:
        if isinstance(item, str):
            name = self._sensor.name
            self.fault(time_ns, name, FaultKind.MALFORMED, f"{name}: {item}")
        elif self._sampling:
            self._pending.extend(self._sensor.readings(item, time_ns))

    def _serve_outage(self, timeout_s: float) -> None:
        reopened = self._outage.serve(0, timeout_s)
        if reopened is not None:
            self._pending.append(reopened)
            if self._sampling:
                self._port.say(self._sensor.options.start_text)
                self._sensor.start(self._clock.now_ns())

    def _listen(self) -> str:
        """Wait for a sample; what is wrong, "" when one came."""
        if self._outage.lasts:
            return f"port '{self.name}' is gone; it is being opened again"
        timeout_s = self._sensor.timeout_ns / SECOND
        seen = malformed = 0
        try:
            self._port.say(self._sensor.options.start_text)
            for wait_s in waits(timeout_s):
                data = self._port.read(wait_s)
                seen += len(data)
                for item in self._sensor.samples(data) if data else ():
                    if isinstance(item, Sample):
                        return ""
                    malformed += 1
        except LinkBroken as error:
            return str(error)
        what = "no bytes came" if not seen else f"{seen} bytes came, {malformed} pieces malformed"
        return (
            f"{self._sensor.name} sent no valid sample within {timeout_s:g} s ({what}); check its "
            f"baud rate, wiring, power, and that the format in the rig is its own"
        )
