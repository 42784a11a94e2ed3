"""TCP connections to ports in memory: what drivers use of a socket, without a network.

`socket.create_connection` is replaced while a bench runs: an address of a port in memory gives a
connection to it, every other one is opened as ever.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from sim_devices.in_memory.port import TCP_HOST, HostEnd, connect

STEP_S = 0.001


class MemoryConnection:
    """A connection to a port in memory, as far as it is used like a socket."""

    def __init__(self, end: HostEnd) -> None:
        self._end = end
        self._timeout_s: float | None = None

    def settimeout(self, value: float | None) -> None:
        """How long `recv` waits [s]."""
        self._timeout_s = value

    def setsockopt(self, *_: Any) -> None:
        """There is no delay to switch off."""

    def recv(self, bufsize: int) -> bytes:
        """What has come, waiting for it; nothing when the other end is gone. Raises TimeoutError."""
        left_s = math.inf if self._timeout_s is None else self._timeout_s
        while not self._end.broken:
            data = self._end.read(bufsize)
            if data:
                return data
            if left_s <= 0.0:
                raise TimeoutError("timed out")
            time.sleep(min(STEP_S, left_s))
            left_s -= STEP_S
        return b""

    def sendall(self, data: bytes) -> None:
        """Send ``data``; raises OSError when the other end is gone."""
        self._end.write(bytes(data))

    def close(self) -> None:
        """Let the port go."""
        self._end.close()


@contextmanager
def connections_in_memory() -> Iterator[None]:
    """Inside, ports in memory can be connected to."""
    elsewhere = socket.create_connection

    def create(address: tuple[str, int], *args: Any, **options: Any) -> Any:
        if address[0] != TCP_HOST:
            return elsewhere(address, *args, **options)
        return MemoryConnection(connect(f"{address[0]}:{address[1]}"))

    with patch.object(socket, "create_connection", create):
        yield
