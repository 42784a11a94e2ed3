"""A virtual port on TCP: a server that one host at a time connects to.

For lines that are reached by network: serial servers (``socket://HOST:PORT`` of pyserial), Modbus
TCP devices, socketcand daemons. A host that hangs up lets the next one in. A host that does
not read loses whole answers, never parts of one; they are counted.

It listens on this computer only: its protocols know no password, so an address that others reach
is refused.
"""

from __future__ import annotations

import errno
import ipaddress
import socket

from sim_devices.errors import PortTaken, PortUnavailable
from sim_devices.line import Line
from sim_devices.outbox import Outbox

READ_SIZE = 65_536
LARGEST_NUMBER = 65_535
MOST_WAITING = 65_536
"""Bytes kept for a host that does not read, beside what the kernel keeps."""


class TcpServerPort:
    """A server with ``line`` at its far end. See `sim_devices.port.Port`.

    Args:
        name: port name of the rig.
        address: ``HOST:PORT``, with or without a scheme in front; port 0 takes a free one.
        line: what answers.
        greeting: what a host is told as soon as it has connected.

    Attributes:
        address: the same, with the port that was taken.
    """

    polled = False

    def __init__(self, name: str, address: str, line: Line, greeting: bytes = b"") -> None:
        self.name = name
        self.address = address
        self._line = line
        self._greeting = greeting
        self._server: socket.socket | None = None
        self._host: socket.socket | None = None
        self._outbox = Outbox(line, MOST_WAITING)

    @property
    def lost_bytes(self) -> int:
        """Bytes thrown away because the host did not read."""
        return self._outbox.lost_bytes

    def open(self) -> None:
        """Listen at the address; raises PortTaken or PortUnavailable."""
        scheme, separator, place = self.address.rpartition("://")
        host, _, number = place.rpartition(":")
        if not host or not number.isdecimal() or int(number) > LARGEST_NUMBER:
            raise PortUnavailable(
                f"port '{self.name}' is at '{self.address}', expected HOST:PORT to listen at"
            )
        try:
            if not _only_here(host):
                raise PortUnavailable(
                    f"port '{self.name}' is at '{self.address}', which others can reach; virtual "
                    f"devices listen on this computer only, give it an address such as 127.0.0.1:{number}"
                )
            self._server = socket.create_server((host, int(number)), backlog=1)
        except (OSError, OverflowError) as error:
            kind = PortTaken if getattr(error, "errno", 0) == errno.EADDRINUSE else PortUnavailable
            raise kind(
                f"cannot listen at {self.address} for port '{self.name}': {error}"
            ) from error
        self._server.setblocking(False)
        # The same one again, when it is unplugged and comes back.
        self.address = f"{scheme}{separator}{host}:{self._server.getsockname()[1]}"

    def close(self) -> None:
        """Stop to listen, and drop the host."""
        self._drop_host()
        server, self._server = self._server, None
        if server is not None:
            server.close()

    def fileno(self) -> int | None:
        """Of the host's connection, or of the server that waits for one."""
        waiting = self._host or self._server
        return None if waiting is None else waiting.fileno()

    def serve(self, time_s: float) -> None:
        """Let a host in, or take what it has sent and answer it."""
        if self._server is None:
            return
        if self._host is None:
            try:
                self._host, _ = self._server.accept()
            except BlockingIOError:
                return
            self._host.setblocking(False)
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._send(self._greeting)
            return
        try:
            data = self._host.recv(READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop_host()
            return
        self._send(self._line.receive(data, time_s))

    def tick(self, time_s: float) -> None:
        """Let time pass for the line, and send what became due."""
        self._send(self._line.tick(time_s))

    def _send(self, data: bytes) -> None:
        if self._host is None:
            return
        try:
            self._outbox.send(data, self._host.send)
        except OSError:
            self._drop_host()

    def _drop_host(self) -> None:
        host, self._host = self._host, None
        self._outbox.clear()
        if host is not None:
            host.close()
            self._line.hang_up()


def _only_here(host: str) -> bool:
    """Whether every address of ``host`` is of the loopback interface; raises OSError where it has none."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return all(ipaddress.ip_address(str(each[4][0])).is_loopback for each in found)
