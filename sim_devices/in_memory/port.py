"""A port in memory: two buffers between a line of virtual devices and one host."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable

from sim_devices.errors import PortTaken
from sim_devices.line import Line

SCHEME = "loopcal"
TCP_HOST = "loopcal.invalid"
"""Of the addresses of TCP ports in memory: a name that no network has."""
MOST_WAITING = 65_536
"""Bytes kept for a host that does not read."""

_open_ports: dict[str, MemoryPort] = {}


class MemoryPort:
    """The far end of an address in memory; see `sim_devices.port.Port`.

    Attributes:
        name: port name of the rig.
        address: ``loopcal://NAME``, or ``loopcal.invalid:NUMBER`` of a TCP port.
        on_written: called when the host has sent something.
        opened: how often a host has tried to open it, since it was made.
        lost_bytes: bytes thrown away because the host did not read.
    """

    polled = False

    def __init__(self, name: str, address: str, line: Line) -> None:
        self.name = name
        self.address = address
        self.on_written: Callable[[], None] = _nobody
        self.opened = 0
        self.lost_bytes = 0
        self._line = line
        self._host: HostEnd | None = None
        self._from_host = b""

    def open(self) -> None:
        """Appear at the address; raises PortTaken."""
        if _open_ports.get(self.address, self) is not self:
            raise PortTaken(f"the address {self.address} for port '{self.name}' is taken")
        _open_ports[self.address] = self

    def close(self) -> None:
        """Disappear again: the host's end breaks."""
        _open_ports.pop(self.address, None)
        if self._host is not None:
            self._host.broken = True
            self._let_go()

    def fileno(self) -> None:
        """Nothing to select on."""
        return

    def serve(self, time_s: float) -> None:
        """Take what the host has sent and answer it."""
        data, self._from_host = self._from_host, b""
        if data:
            self._send(self._line.receive(data, time_s))

    def tick(self, time_s: float) -> None:
        """Let time pass for the line."""
        self._send(self._line.tick(time_s))

    def connect(self) -> HostEnd:
        """The end of a new host; raises OSError where another has the port."""
        if self._host is not None:
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        self._host = HostEnd(self)
        return self._host

    def take(self, data: bytes) -> None:
        """The host has sent something."""
        self._from_host += data
        self.on_written()

    def hang_up(self, host: HostEnd) -> None:
        """The host lets go of the port."""
        if self._host is host:
            self._let_go()

    def _let_go(self) -> None:
        self._host = None
        self._from_host = b""
        self._line.hang_up()

    def _send(self, data: bytes) -> None:
        if not data or self._host is None:
            return
        if len(self._host.received) + len(data) > MOST_WAITING:
            self.lost_bytes += len(data)
            self._line.overrun()
        else:
            self._host.received += data


class HostEnd:
    """The host's end of a port.

    Attributes:
        received: what has come and has not been read.
        broken: whether the port has gone away.
    """

    def __init__(self, port: MemoryPort) -> None:
        self.received = bytearray()
        self.broken = False
        self._port = port

    def read(self, size: int) -> bytes:
        """What has come, at most ``size`` bytes; raises OSError when the port is gone."""
        self.require()
        data = bytes(self.received[:size])
        del self.received[:size]
        return data

    def write(self, data: bytes) -> None:
        """Send ``data``; raises OSError when the port is gone."""
        self.require()
        self._port.take(data)

    def close(self) -> None:
        """Let the port go."""
        self._port.hang_up(self)

    def require(self) -> None:
        """Raise OSError when the port is gone."""
        if self.broken:
            raise OSError(errno.EIO, os.strerror(errno.EIO))


attempts: dict[str, int] = {}
"""How often hosts have tried to open each address, whether there was a port or not."""


def connect(address: str) -> HostEnd:
    """The host's end of the port at ``address``; raises OSError as opening it would anywhere."""
    attempts[address] = attempts.get(address, 0) + 1
    port = _open_ports.get(address)
    if port is None and address.startswith(TCP_HOST):
        raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
    if port is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), address)
    return port.connect()


def _nobody() -> None:
    """Nobody waits for what the host sends."""
