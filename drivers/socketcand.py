"""CAN through a socketcand daemon: a bus of another computer, over TCP.

python-can's own interface spins when the daemon closes the connection, never recovers from
one malformed frame, and misses the handshake when an answer arrives together with a frame.
This one reads whatever has arrived as a stream of elements, each from ``<`` to ``>``.

    daemon -> host   < hi >                              after connecting
                     < ok >, < error TEXT >              answers to open and rawmode
                     < frame ID SECONDS.MICROS DATA >    ID: 3 or 8 hex digits; DATA: hex pairs
                     < error ID SECONDS.MICROS >         an error frame
    host -> daemon   < open CHANNEL >, < rawmode >, < send ID LENGTH DATA >

Elements that are neither are counted (`SocketcandBus.malformed`) and passed over. The time of a
frame is the daemon's. The bit rate is the daemon's business.

Source: socketcand, doc/protocol.md.
"""

from __future__ import annotations

import re
import socket
import time
from collections import deque
from typing import Any

import can
from can.exceptions import CanInitializationError, CanOperationError
from pydantic import Field

from drivers.waiting import waits
from recordings.rig.quantity import Described

CONNECT_TIMEOUT_S = 2.0
SEND_TIMEOUT_S = 0.25
BLOCK = 65_536
LONGEST_ELEMENT = 256
FRAME = re.compile(
    rb"frame ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) (\d+\.\d+) ?((?:[0-9A-Fa-f]{2} ?){0,8})"
)
LARGEST_STANDARD_ID, LARGEST_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF


class SocketcandOptions(Described):
    """Options of a CAN port with ``interface = "socketcand"``.

    Attributes:
        host: name or address of the daemon's computer.
        port: its TCP port.
    """

    host: str
    port: int = Field(default=29_536, ge=1, le=65_535)


class ElementBuffer:
    """Cuts what arrives into elements, without their brackets; what is between them is dropped."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The elements that ``data`` completes."""
        *whole, self._rest = (self._rest + data).split(b">")
        if len(self._rest) > LONGEST_ELEMENT:
            whole.append(self._rest)
            self._rest = b""
        return [each.rpartition(b"<")[2].strip() for each in whole]


def decode(element: bytes) -> can.Message | None:
    """The frame or error frame of an element, None for what is neither."""
    if element.startswith(b"error "):
        return can.Message(is_error_frame=True)
    match = FRAME.fullmatch(element)
    if match is None:
        return None
    digits, stamp, data = match.groups()
    identifier, extended = int(digits, 16), len(digits) > 3
    if identifier > (LARGEST_EXTENDED_ID if extended else LARGEST_STANDARD_ID):
        return None
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        timestamp=float(stamp),
        data=bytes.fromhex(data.decode()),
    )


def encode(message: can.Message) -> bytes:
    """The element that sends ``message``."""
    digits = f"{message.arbitration_id:08X}" if message.is_extended_id else ""
    data = "".join(f" {byte:02X}" for byte in message.data)
    return f"< send {digits or f'{message.arbitration_id:03X}'} {message.dlc}{data} >".encode()


class SocketcandBus:
    """A connection to a daemon, in raw mode. See `drivers.can_bus.Bus`.

    Args:
        channel: the daemon's name of the bus, such as ``can0``.
        host, port: see `SocketcandOptions`.

    Attributes:
        malformed: elements that made no sense, since the connection was made.

    Raises:
        CanInitializationError: there is no daemon, or it refuses the bus.
    """

    def __init__(self, channel: str, *, host: str, port: int = 29_536, **_: Any) -> None:
        self.malformed = 0
        self._where = f"socketcand at {host}:{port}"
        self._elements = ElementBuffer()
        self._received: deque[bytes] = deque()
        try:
            self._socket = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except OSError as error:
            raise CanInitializationError(f"cannot reach {self._where}: {error}") from error
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._expect(b"hi")
            for command in (f"< open {channel} >", "< rawmode >"):
                self._socket.sendall(command.encode())
                self._expect(b"ok")
        except OSError as error:
            self._socket.close()
            raise CanInitializationError(f"{self._where}: {error}") from error
        except CanInitializationError:
            self._socket.close()
            raise

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, None after ``timeout`` seconds; raises CanOperationError when it is gone."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            while self._received:
                message = decode(self._received.popleft())
                if message is not None:
                    return message
                self.malformed += 1
            left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            if not self._fill(left):
                return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, waiting at most 0.25 s; raises CanOperationError."""
        self._socket.settimeout(SEND_TIMEOUT_S if timeout is None else timeout)
        try:
            self._socket.sendall(encode(msg))
        except OSError as error:
            raise CanOperationError(f"{self._where} does not take a frame: {error}") from error

    def shutdown(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _fill(self, timeout_s: float | None) -> bool:
        """Take what has come; False when nothing has within ``timeout_s``."""
        # A timeout of 0 would be non-blocking, which raises another error.
        self._socket.settimeout(timeout_s if timeout_s is None else max(timeout_s, 1e-6))
        try:
            data = self._socket.recv(BLOCK)
        except TimeoutError:
            return False
        except OSError as error:
            raise CanOperationError(f"{self._where} is gone: {error}") from error
        if not data:
            raise CanOperationError(f"{self._where} has closed the connection")
        self._received.extend(self._elements.feed(data))
        return True

    def _expect(self, answer: bytes) -> None:
        """Wait for an answer of the handshake; frames that come with it are kept."""
        kept: list[bytes] = []
        for wait_s in waits(CONNECT_TIMEOUT_S):
            if not self._received:
                self._fill_at_handshake(wait_s)
            while self._received:
                element = self._received.popleft()
                if element == answer:
                    self._received.extendleft(reversed(kept))
                    return
                if element.startswith(b"error") and not kept:
                    raise CanInitializationError(
                        f"{self._where} says: {element.decode('ascii', 'backslashreplace')}"
                    )
                kept.append(element)
        raise CanInitializationError(
            f"{self._where} did not say '{answer.decode()}' within {CONNECT_TIMEOUT_S} s; "
            f"is it a socketcand daemon?"
        )

    def _fill_at_handshake(self, timeout_s: float) -> None:
        try:
            self._fill(timeout_s)
        except CanOperationError as error:
            raise CanInitializationError(str(error)) from error
