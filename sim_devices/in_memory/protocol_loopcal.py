"""``loopcal://NAME`` for pyserial: the host's end of a port in memory.

pyserial finds this module by the name of the scheme, once its package is among
`serial.protocol_handler_packages`. Waiting for bytes goes by `time.sleep`, in small steps, so
that it works by the virtual clock that `sim_devices.virtual_time.time_is` puts in its place.
"""

from __future__ import annotations

import math
import time
from typing import Any

from serial import SerialException  # type: ignore[import-untyped]
from serial.serialutil import PortNotOpenError, SerialBase  # type: ignore[import-untyped]

from sim_devices.in_memory.port import HostEnd, connect

STEP_S = 0.001
"""How finely a host that waits sees the time pass."""


class Serial(SerialBase):  # type: ignore[misc]
    """A serial port in memory, as pyserial has them."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._end: HostEnd | None = None
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Open the port; raises SerialException with the error number of the system's."""
        try:
            self._end = connect(self._port)
        except OSError as error:
            raise SerialException(
                error.errno, f"could not open port {self._port}: {error}"
            ) from error
        self.is_open = True

    def close(self) -> None:
        """Let the port go."""
        if self._end is not None:
            self._end.close()
            self._end = None
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """Bytes that have come."""
        end = self._opened()
        end.require()
        return len(end.received)

    def read(self, size: int = 1) -> bytes:
        """Read ``size`` bytes, or fewer after the timeout."""
        end = self._opened()
        left_s = math.inf if self._timeout is None else self._timeout
        data = end.read(size)
        while len(data) < size and left_s > 0.0:
            time.sleep(min(STEP_S, left_s))
            left_s -= STEP_S
            data += end.read(size - len(data))
        return data

    def write(self, data: bytes) -> int:
        """Send ``data``."""
        self._opened().write(bytes(data))
        return len(data)

    def reset_input_buffer(self) -> None:
        """Throw away what has come."""
        end = self._opened()
        end.read(len(end.received))

    def reset_output_buffer(self) -> None:
        """Nothing waits to be sent."""

    def flush(self) -> None:
        """Nothing waits to be sent."""

    def _opened(self) -> HostEnd:
        if self._end is None:
            raise PortNotOpenError
        return self._end

    def _reconfigure_port(self) -> None:
        """Baud rate and parity have no effect."""

    def _update_dtr_state(self) -> None:
        """There are no handshake lines."""

    def _update_rts_state(self) -> None:
        """There are no handshake lines."""
