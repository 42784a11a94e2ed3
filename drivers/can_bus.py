"""A CAN bus through python-can, made safe to use for hours.

python-can's buses raise whatever their libraries raise, and some of it is harmless (a
garbled frame) and some is not (the adapter is gone). Here a bus gives frames stamped on
arrival, counts what is garbled, and raises `LinkBroken` when it is gone.

Known habits of python-can 4.6 that are handled here: interfaces raise ValueError for a
garbled frame, or pad a short payload in silence; ``send`` without a timeout may block for ever
on a peer that does not read; time stamps follow the wall clock, so the arrival is stamped
here. Its slcan and socketcand interfaces are replaced by `drivers.slcan` and
`drivers.socketcand`. A board that resets when its port is
opened gets its time to come up, except on a pty or a URL, where there is none.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import can
from can.exceptions import error_check
from can.interfaces import VALID_INTERFACES
from pydantic import ValidationError

from drivers.errors import BadCommand, BusOff, LinkBroken, LinkClosed, OptionError, option_faults
from drivers.link import Clock
from drivers.ports import DeviceLock, is_pseudo_terminal, open_error
from drivers.slcan import BIT_RATES, BUS_OFF, SlcanBus, SlcanMessage, SlcanOptions
from drivers.socketcand import SocketcandBus, SocketcandOptions
from recordings.rig import CanPort
from recordings.rig.quantity import Described

SEND_TIMEOUT_S = 0.25
LONGEST = 8
EXTENDED = 1 << 31
"""Marks an identifier of 29 bits, as in DBC files."""

# Without a handler of its own, Python prints a library's warnings to the terminal of the user.
logging.getLogger("can").addHandler(logging.NullHandler())


class Frame(NamedTuple):
    """A CAN data frame; a tuple, because a full bus has 9,000 of them a second.

    Attributes:
        identifier: CAN identifier, with `EXTENDED` set where it has 29 bits.
        data: payload, 0 to 8 bytes.
        time_ns: when it arrived.
        device_time_ns: the adapter's time stamp on a clock of its own, or None.
    """

    identifier: int
    data: bytes
    time_ns: int
    device_time_ns: int | None = None


class Bus(Protocol):
    """What is used of a python-can bus."""

    def recv(self, timeout: float | None = None) -> can.Message | None: ...

    def send(self, msg: can.Message, timeout: float | None = None) -> None: ...

    def shutdown(self) -> None: ...


def connect(port: CanPort) -> Bus:
    """A python-can bus for ``port``; raises whatever the interface raises."""
    options: dict[str, Any] = dict(port.options)
    if port.interface == "slcan":
        if "://" in port.channel or is_pseudo_terminal(port.channel):
            options.setdefault("sleep_after_open", 0.0)
        options |= {"listen_only": port.listen_only, "time_stamps": port.adapter_time}
        return SlcanBus(port.channel, port.bitrate, **options)
    if port.interface == "socketcand":
        return SocketcandBus(port.channel, **options)
    return can.Bus(interface=port.interface, channel=port.channel, bitrate=port.bitrate, **options)


class CanBus:
    """A bus that can be opened again.

    Args:
        port: what to open.
        clock: stamps arrivals.
        connect: makes the python-can bus.

    Attributes:
        error_frames: error frames of the controller, since the bus was made.
    """

    def __init__(
        self, port: CanPort, clock: Clock, connect: Callable[[CanPort], Bus] = connect
    ) -> None:
        if port.interface not in VALID_INTERFACES:
            raise OptionError(
                f"port '{port.name}': 'interface' is '{port.interface}', "
                f"expected one of: {', '.join(sorted(VALID_INTERFACES))}"
            )
        _check_options(port)
        self._port = port
        self._clock = clock
        self._connect = connect
        self._lock = DeviceLock()
        self._bus: Bus | None = None
        self._malformed = 0
        self.error_frames = 0

    def open(self) -> None:
        """Open the bus; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        try:
            if self._port.interface == "slcan":
                self._lock.acquire(self._port.channel)
            with error_check(exception_type=can.CanInitializationError):
                self._bus = self._connect(self._port)
        except (can.CanError, OSError) as error:
            self._lock.release()
            raise open_error(self._port.name, self._port.channel, error) from error

    @property
    def malformed(self) -> int:
        """Frames that made no sense, since the bus was made."""
        return self._malformed + int(getattr(self._bus, "malformed", 0))

    def send(self, identifier: int, data: bytes) -> None:
        """Send a data frame; raises BadCommand where the port listens only, LinkBroken, LinkClosed."""
        if self._port.listen_only:
            raise BadCommand(f"port '{self._port.name}' listens only; nothing may be sent on it")
        message = can.Message(
            arbitration_id=identifier & ~EXTENDED,
            data=data,
            is_extended_id=bool(identifier & EXTENDED),
        )
        bus = self._open_bus()
        try:
            with error_check():
                bus.send(message, timeout=SEND_TIMEOUT_S)
        except can.CanError as error:
            raise self._broken(error) from error

    def receive_all(self, timeout_s: float, most: int) -> list[Frame]:
        """Data frames that have come, in order, at most ``most``; else the next, as `receive` gives it.

        Empty after ``timeout_s``, or after something that is no data frame. Raises as `receive`.
        """
        bus = self._open_bus()
        if isinstance(bus, SlcanBus):
            try:
                plain = bus.take_plain(timeout_s, most)
            except can.CanError as error:
                raise self._broken(error) from error
            if plain or not bus.waiting:
                time_ns = self._clock.now_ns()
                return [Frame(identifier, data, time_ns) for identifier, data in plain]
        frame = self.receive(timeout_s)
        return [] if frame is None else [frame]

    def receive(self, timeout_s: float) -> Frame | None:
        """The next data frame, or None after ``timeout_s`` or something that is not one.

        Raises:
            BusOff: the controller has left the bus; close and open it again.
            LinkBroken: the bus is gone.
            LinkClosed: the bus is not open.
        """
        bus = self._open_bus()
        try:
            message = self._next_message(bus, timeout_s)
            time_ns = self._clock.now_ns()
        except can.CanError as error:
            raise self._broken(error) from error
        if message is None or message.is_remote_frame:
            return None
        if message.is_error_frame:
            if message.arbitration_id & BUS_OFF:
                raise BusOff(
                    f"the controller of port '{self._port.name}' at '{self._port.channel}' has left "
                    f"the bus (bus off): check bit rate, termination, wiring, and a device that disturbs"
                )
            self.error_frames += 1
            return None
        if message.is_fd:
            return None
        if message.dlc > LONGEST or len(message.data) != message.dlc:
            self._malformed += 1
            return None
        identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        return Frame(identifier, bytes(message.data), time_ns, self._device_time_ns(message))

    def close(self) -> None:
        """Let the bus go; harmless when it is not open."""
        bus, self._bus = self._bus, None
        self._malformed += int(getattr(bus, "malformed", 0))
        try:
            if bus is not None:
                with error_check():
                    bus.shutdown()
        except can.CanError:
            # An adapter that is gone cannot take the farewell, and nothing depends on it.
            return
        finally:
            self._lock.release()

    def _next_message(self, bus: Bus, timeout_s: float) -> can.Message | None:
        # What error_check does, without its price: this is called for every frame.
        try:
            return bus.recv(timeout_s)
        except Exception as error:
            if _is_garble(error):
                self._malformed += 1
                return None
            if isinstance(error, can.CanError):
                raise
            raise can.CanOperationError(str(error)) from error

    def _device_time_ns(self, message: can.Message) -> int | None:
        if isinstance(message, SlcanMessage):
            return message.adapter_ns
        return round(message.timestamp * 1e9) if self._port.adapter_time else None

    def _open_bus(self) -> Bus:
        if self._bus is None:
            raise LinkClosed(f"port '{self._port.name}' is not open")
        return self._bus

    def _broken(self, error: can.CanError) -> LinkBroken:
        return LinkBroken(f"port '{self._port.name}' at '{self._port.channel}' is gone: {error}")


OPTIONS: dict[str, type[Described]] = {"slcan": SlcanOptions, "socketcand": SocketcandOptions}


def _check_options(port: CanPort) -> None:
    if port.interface == "slcan" and port.bitrate not in BIT_RATES:
        known = ", ".join(map(str, BIT_RATES))
        raise OptionError(
            f"port '{port.name}': 'bitrate' is {port.bitrate}, slcan adapters know: {known}"
        )
    if port.interface not in OPTIONS:
        return
    try:
        OPTIONS[port.interface].model_validate(port.options)
    except ValidationError as error:
        raise OptionError(
            f"port '{port.name}' has wrong options: {option_faults(error)}"
        ) from error


def _cause(error: BaseException) -> BaseException:
    while error.__cause__ is not None:
        error = error.__cause__
    return error


def _is_garble(error: BaseException) -> bool:
    """Whether an interface stumbled over what it received, rather than over its port."""
    return isinstance(_cause(error), ValueError | IndexError)
