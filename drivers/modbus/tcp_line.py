"""A TCP connection to a Modbus server: sends a request, waits for the reply that belongs to it.

Owns the connection and the arrival time of a reply. Replies to requests that were given up are
told by their transaction, counted, and passed over.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Protocol

from drivers.errors import DeviceRefused, DeviceSilent, LinkBroken, LinkClosed, Malformed
from drivers.link import Clock
from drivers.modbus.line import Answer
from drivers.modbus.mbap import LARGEST_TRANSACTION, Adu, AduBuffer, encode
from drivers.modbus.pdu import Identify, Read, Verdict, read_reply
from drivers.ports import open_error
from drivers.waiting import waits
from recordings.rig import TcpPort

CONNECT_TIMEOUT_S = 2.0
BLOCK = 4096
SHORTEST_WAIT_S = 1e-6


class Connection(Protocol):
    """What is used of a socket."""

    def settimeout(self, value: float | None, /) -> None: ...

    def recv(self, bufsize: int, /) -> bytes: ...

    def sendall(self, data: bytes, /) -> None: ...

    def close(self) -> None: ...


def connect(port: TcpPort) -> Connection:
    """A connection; raises OSError."""
    connection = socket.create_connection((port.host, port.number), CONNECT_TIMEOUT_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


class TcpLine:
    """A connection that can be opened again. See `drivers.modbus.line.Line`.

    Args:
        port: whom to connect to.
        clock: stamps arrivals.
        connect: makes the connection.

    Attributes:
        late: replies that came after their request had been given up, since the line was made.
        foreign: replies to our requests that came from another unit, since the line was made.
        noise: none: a stream that is no Modbus TCP breaks the connection.
    """

    ties_replies = True

    def __init__(
        self, port: TcpPort, clock: Clock, connect: Callable[[TcpPort], Connection] = connect
    ) -> None:
        self._port = port
        self._clock = clock
        self._connect = connect
        self._connection: Connection | None = None
        self._buffer = AduBuffer()
        self._transaction = 0
        self.late = 0
        self.foreign = 0
        self.noise = 0

    def open(self) -> None:
        """Connect; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        try:
            self._connection = self._connect(self._port)
        except OSError as error:
            raise open_error(self._port.name, self._port.address, error) from error
        self._buffer = AduBuffer()

    def close(self) -> None:
        """Let the connection go; harmless when it is not open."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def ask(self, request: Read | Identify, timeout_s: float) -> Answer:
        """Send ``request`` and return its reply; raises as `drivers.modbus.line.Line.ask`."""
        connection = self._connection
        if connection is None:
            raise LinkClosed(f"port '{self._port.name}' is not open")
        try:
            return self._ask(connection, request, timeout_s)
        except OSError as error:
            raise self._broken(str(error)) from error

    def _ask(self, connection: Connection, request: Read | Identify, timeout_s: float) -> Answer:
        self._transaction = self._transaction % LARGEST_TRANSACTION + 1
        connection.settimeout(timeout_s)
        connection.sendall(encode(request, self._transaction))
        for wait_s in waits(timeout_s):
            # A timeout of 0 would be non-blocking, which raises another error.
            connection.settimeout(max(wait_s, SHORTEST_WAIT_S))
            try:
                data = connection.recv(BLOCK)
            except TimeoutError:
                continue
            time_ns = self._clock.now_ns()
            if not data:
                raise self._broken("the server has closed the connection")
            answers = [adu for adu in self._frames(data) if self._is_answer(adu, request)]
            if answers:
                return self._answer(answers[0], request, time_ns)
        raise DeviceSilent(
            f"unit {request.unit} sent no reply within {timeout_s} s; check its unit id, and that "
            f"the server at {self._port.address} serves it"
        )

    def _frames(self, data: bytes) -> list[Adu]:
        try:
            return self._buffer.feed(data)
        except Malformed as error:
            # Where the next frame begins is not known: only a new connection helps.
            raise self._broken(str(error)) from error

    def _is_answer(self, adu: Adu, request: Read | Identify) -> bool:
        if adu.transaction != self._transaction:
            self.late += 1
            return False
        self.foreign += adu.unit != request.unit
        return adu.unit == request.unit

    def _answer(self, adu: Adu, request: Read | Identify, time_ns: int) -> Answer:
        reply = read_reply(adu.pdu, request)
        if reply.verdict is Verdict.REFUSAL:
            raise DeviceRefused(f"unit {request.unit} answers {reply.exception_text}")
        if reply.verdict is Verdict.LATE:
            raise Malformed(f"unit {request.unit} sent {len(adu.pdu) - 2} bytes of registers")
        return Answer(reply, time_ns)

    def _broken(self, why: str) -> LinkBroken:
        return LinkBroken(f"port '{self._port.name}' at '{self._port.address}' is gone: {why}")
