"""A serial port, pty or pyserial URL, read in whole blocks.

pyserial reads byte by byte where it does not know how much has come (always, on a socket), sets
up the port anew for each change of its timeout, and does not close a socket whose peer is gone.
Here one wait and one read give all that has come: what full CAN buses and ADC streams need.
``socket://HOST:PORT`` is a plain TCP connection.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
from typing import Protocol
from urllib.parse import urlsplit

import serial  # type: ignore[import-untyped]

from drivers.waiting import waits

BLOCK = 65_536
WRITE_TIMEOUT_S = 0.25
CONNECT_TIMEOUT_S = 2.0


class SerialBlocks(Protocol):
    """An open port."""

    def read(self, timeout_s: float | None) -> bytes:
        """All that has come; if nothing has, what comes first within ``timeout_s`` (None: for ever).

        Raises:
            OSError: the port is gone.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data``, waiting at most `WRITE_TIMEOUT_S`; raises OSError."""
        ...

    def close(self) -> None:
        """Let the port go."""
        ...


def open_blocks(
    path: str,
    *,
    baudrate: int,
    parity: str = "N",
    stopbits: int = 1,
    rtscts: bool = False,
    exclusive: bool | None = None,
) -> SerialBlocks:
    """Open a port.

    Args:
        path: device path or any URL of pyserial.
        baudrate, parity, stopbits, rtscts: as in pyserial; a pty or URL ignores them.
        exclusive: lock a device path against a second user.

    Raises:
        OSError: the port cannot be opened.
        ValueError: no such kind of URL, or a parameter that the port cannot have.
    """
    if path.startswith("socket://"):
        return _Socket(path)
    return _Terminal(
        serial.serial_for_url(
            path,
            baudrate=baudrate,
            parity=parity,
            stopbits=stopbits,
            rtscts=rtscts,
            exclusive=exclusive,
            timeout=0.0,
            write_timeout=WRITE_TIMEOUT_S,
        )
    )


class _Socket:
    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.hostname is None or parts.port is None:
            raise ValueError(f"'{url}' is no URL of a socket, expected socket://HOST:PORT")
        self._socket = socket.create_connection((parts.hostname, parts.port), CONNECT_TIMEOUT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, timeout_s: float | None) -> bytes:
        # A timeout of 0 would be non-blocking, which raises another error.
        self._socket.settimeout(None if timeout_s is None else max(timeout_s, 1e-6))
        try:
            data = self._socket.recv(BLOCK)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionResetError("the other end has closed the connection")
        return data

    def write(self, data: bytes) -> None:
        self._socket.settimeout(WRITE_TIMEOUT_S)
        self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


class _Terminal:
    def __init__(self, port: serial.SerialBase) -> None:
        self._serial = port
        self._poll = None
        if os.name == "posix":
            try:
                self._descriptor = int(port.fileno())
            except (AttributeError, OSError):
                # loop:// and rfc2217:// have none to wait on.
                return
            self._poll = select.poll()
            self._poll.register(self._descriptor, select.POLLIN)

    def read(self, timeout_s: float | None) -> bytes:
        if self._poll is None:
            return self._read_slowly(timeout_s)
        if not self._poll.poll(None if timeout_s is None else max(timeout_s, 0.0) * 1000):
            return b""
        data = os.read(self._descriptor, BLOCK)
        if not data:
            raise ConnectionResetError("the device is ready to read, and gives nothing")
        return data

    def write(self, data: bytes) -> None:
        if self._poll is None:
            self._serial.write(data)
            return
        # pyserial calls a write too late that is done, where the host was held up meanwhile.
        for wait_s in waits(WRITE_TIMEOUT_S):
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._descriptor, data) :]
            if not data:
                return
            select.select([], [self._descriptor], [], wait_s)
        raise TimeoutError(errno.ETIMEDOUT, "it takes nothing of what is sent to it")

    def close(self) -> None:
        self._serial.close()

    def _read_slowly(self, timeout_s: float | None) -> bytes:
        """Where there is no descriptor to wait on."""
        if not self._serial.in_waiting:
            if timeout_s != self._serial.timeout:
                self._serial.timeout = timeout_s
            first: bytes = self._serial.read(1)
            return first + self._serial.read(self._serial.in_waiting) if first else b""
        data: bytes = self._serial.read(self._serial.in_waiting)
        return data
