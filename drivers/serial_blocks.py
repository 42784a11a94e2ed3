"""A serial port, pty or pyserial URL, read in whole blocks.

pyserial reads byte by byte where it does not know how much has come (always, on a socket), and
sets up the port anew for each change of its timeout. Here one wait and one read give all that
has come: what full CAN buses and ADC streams need.
"""

from __future__ import annotations

import io
import os
import select
import sys

import serial  # type: ignore[import-untyped]

BLOCK = 65_536
WRITE_TIMEOUT_S = 0.25


class SerialBlocks:
    """An open port.

    Args:
        path: device path or any URL of pyserial.
        baudrate, parity, stopbits, rtscts: as in pyserial; a pty or URL ignores them.
        exclusive: lock a device path against a second user.

    Raises:
        OSError: the port cannot be opened.
        ValueError: pyserial does not know the URL, or a parameter.
    """

    def __init__(
        self,
        path: str,
        *,
        baudrate: int,
        parity: str = "N",
        stopbits: int = 1,
        rtscts: bool = False,
        exclusive: bool | None = None,
    ) -> None:
        self._serial = serial.serial_for_url(
            path,
            baudrate=baudrate,
            parity=parity,
            stopbits=stopbits,
            rtscts=rtscts,
            exclusive=exclusive,
            timeout=0.0,
            write_timeout=WRITE_TIMEOUT_S,
        )
        self._poll = None
        if sys.platform != "win32":
            try:
                descriptor = self._serial.fileno()
            except (AttributeError, io.UnsupportedOperation):
                return
            self._descriptor = descriptor
            self._poll = select.poll()
            self._poll.register(descriptor, select.POLLIN)

    def read(self, timeout_s: float | None) -> bytes:
        """All that has come; if nothing has, what comes first within ``timeout_s`` (None: for ever).

        Raises:
            OSError: the port is gone.
        """
        if self._poll is None:
            return self._read_slowly(timeout_s)
        wait_ms = None if timeout_s is None else max(timeout_s, 0.0) * 1000
        if not self._poll.poll(wait_ms):
            return b""
        data = os.read(self._descriptor, BLOCK)
        if not data:
            raise ConnectionResetError("the other end has closed the port")
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``, waiting at most `WRITE_TIMEOUT_S`; raises OSError."""
        self._serial.write(data)

    def close(self) -> None:
        """Let the port go."""
        self._serial.close()

    def _read_slowly(self, timeout_s: float | None) -> bytes:
        """Where the port has no descriptor to wait on (Windows, ``loop://``, ``rfc2217://``)."""
        if not self._serial.in_waiting:
            if timeout_s != self._serial.timeout:
                self._serial.timeout = timeout_s
            first: bytes = self._serial.read(1)
            return first + self._serial.read(self._serial.in_waiting) if first else b""
        data: bytes = self._serial.read(self._serial.in_waiting)
        return data
