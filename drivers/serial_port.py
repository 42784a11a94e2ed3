"""A serial port of a rig, which can be opened again and again; its errors are those of this room."""

from __future__ import annotations

from collections.abc import Callable

from drivers.errors import LinkBroken, LinkClosed
from drivers.ports import open_error
from drivers.serial_blocks import SerialBlocks, open_blocks
from recordings.rig import SerialPort as RigPort

Connect = Callable[[RigPort], SerialBlocks]


def connect(port: RigPort) -> SerialBlocks:
    """The port, locked against a second user; raises OSError or ValueError."""
    return open_blocks(
        port.path,
        baudrate=port.baudrate,
        parity=port.parity,
        stopbits=port.stopbits,
        exclusive=True,
    )


class SerialPort:
    """A port, open or not.

    Args:
        port: what to open.
        connect: opens it.
    """

    def __init__(self, port: RigPort, connect: Connect = connect) -> None:
        self._port = port
        self._connect = connect
        self._blocks: SerialBlocks | None = None

    def open(self) -> None:
        """Open the port; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        try:
            self._blocks = self._connect(self._port)
        except (OSError, ValueError) as error:
            raise open_error(self._port.name, self._port.path, error) from error

    def close(self) -> None:
        """Let the port go; harmless when it is not open."""
        blocks, self._blocks = self._blocks, None
        if blocks is not None:
            blocks.close()

    def read(self, timeout_s: float) -> bytes:
        """All that has come, or what comes first within ``timeout_s``; raises LinkBroken, LinkClosed."""
        try:
            return self._open_blocks().read(timeout_s)
        except OSError as error:
            raise self._broken(error) from error

    def write(self, data: bytes) -> None:
        """Send ``data``; raises LinkBroken or LinkClosed."""
        try:
            self._open_blocks().write(data)
        except OSError as error:
            raise self._broken(error) from error

    def _open_blocks(self) -> SerialBlocks:
        if self._blocks is None:
            raise LinkClosed(f"port '{self._port.name}' is not open")
        return self._blocks

    def _broken(self, error: OSError) -> LinkBroken:
        return LinkBroken(f"port '{self._port.name}' at '{self._port.path}' is gone: {error}")
