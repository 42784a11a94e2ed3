"""A virtual serial port: a pseudo-terminal that a symbolic link makes findable.

Owns the link and the bytes on their way to the host. Refuses a path that belongs to
anything else: only a dangling link, left by a bench that was killed, is replaced. Baud rate
and parity have no effect.

A host that closes the port hangs up: the line is told, and what the host had not read is
gone, as with a USB adapter. A host that does not read loses whole answers, never parts of
one; they are counted.
"""

from __future__ import annotations

import errno
import os
import select
import termios
import tty
from functools import partial
from pathlib import Path

from sim_devices.errors import PortTaken, PortUnavailable
from sim_devices.line import Line
from sim_devices.outbox import Outbox

READ_SIZE = 65_536
MOST_WAITING = 16_384
"""Bytes kept for a host that does not read, beside the 4 KiB that the kernel keeps."""


class PtyPort:
    """A pseudo-terminal with ``line`` at its far end, found at ``address``.

    Attributes:
        name: port name of the rig.
        address: path of the link.
    """

    polled = False

    def __init__(self, name: str, address: str, line: Line) -> None:
        self.name = name
        self.address = address
        self._line = line
        self._path = Path(address)
        self._master: int | None = None
        self._terminal = ""
        self._held = False
        self._outbox = Outbox(line, MOST_WAITING)
        self._poll = select.poll()

    @property
    def lost_bytes(self) -> int:
        """Bytes thrown away because the host did not read."""
        return self._outbox.lost_bytes

    def open(self) -> None:
        """Make the terminal and the link; raises PortTaken or PortUnavailable."""
        self._clear_path()
        try:
            self._master, slave = os.openpty()
            self._poll.register(self._master, select.POLLIN)
            self._terminal = os.ttyname(slave)
            tty.setraw(slave)
            os.close(slave)
            os.set_blocking(self._master, False)
        except (OSError, termios.error) as error:
            self.close()
            raise PortUnavailable(
                f"cannot make a pseudo-terminal for port '{self.name}': {error}"
            ) from error
        try:
            self._path.symlink_to(self._terminal)
        except FileExistsError as error:
            self.close()
            raise self._taken("something else has just appeared there") from error
        except OSError as error:
            self.close()
            raise PortUnavailable(
                f"cannot make the link {self._path} for port '{self.name}': {error.strerror}; "
                f"choose a path in an existing folder that you may write"
            ) from error

    def close(self) -> None:
        """Remove the link, if it is still this port's, and the terminal."""
        if self._master is None:
            return
        if self._path.is_symlink() and str(self._path.readlink()) == self._terminal:
            self._path.unlink()
        self._poll.unregister(self._master)
        os.close(self._master)
        self._master = None
        if self._held:
            self._held = False
            self._outbox.clear()
            self._line.hang_up()

    def fileno(self) -> int | None:
        """The terminal's descriptor while a host holds the port, else None."""
        return self._master if self._held else None

    def serve(self, time_s: float) -> None:
        """Take what the host has sent and answer it."""
        data = self._read()
        if data:
            self._send(self._line.receive(data, time_s))

    def tick(self, time_s: float) -> None:
        """Let time pass for the line; notice a host that has come."""
        if self._master is not None:
            self._notice_host()
        self._send(self._line.tick(time_s))

    def _notice_host(self) -> None:
        if self._held:
            return
        for _, event in self._poll.poll(0):
            # A host that has written and gone already still gets its commands obeyed.
            self._held = bool(event & select.POLLIN)
            return
        self._held = True

    def _read(self) -> bytes:
        if self._master is None:
            return b""
        try:
            data = os.read(self._master, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            data = b""
        if not data:
            self._hang_up()
        return data

    def _send(self, data: bytes) -> None:
        if not self._held or self._master is None:
            return
        try:
            self._outbox.send(data, partial(os.write, self._master))
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._hang_up()

    def _hang_up(self) -> None:
        self._held = False
        self._outbox.clear()
        self._line.hang_up()
        # Linux keeps for the next host what the last one did not read; a cable does not.
        slave = os.open(self._terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            termios.tcflush(slave, termios.TCIFLUSH)
        finally:
            os.close(slave)

    def _clear_path(self) -> None:
        if not self._path.is_symlink():
            if self._path.exists():
                raise self._taken("it exists")
            return
        if self._path.exists():
            raise self._taken(f"it is a link to {self._path.readlink()}, which exists")
        try:
            self._path.unlink()
        except OSError as error:
            raise PortUnavailable(
                f"cannot replace the dangling link {self._path} for port '{self.name}': "
                f"{error.strerror}"
            ) from error

    def _taken(self, seen: str) -> PortTaken:
        return PortTaken(
            f"the path {self._path} for port '{self.name}' is taken: {seen}; end the bench that "
            f"uses it, remove it, or choose another path"
        )
