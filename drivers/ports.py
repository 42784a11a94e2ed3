"""Ports of the operating system: what it means when one cannot be opened, and who holds it.

Owns the translation of open errors and the lock on a serial device. The lock is the
advisory one (flock) that pyserial takes for ``exclusive=True``, so that programs which use
either notice each other; a program that locks nothing is not noticed.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

from drivers.errors import DriverError, LinkBroken, PortBusy, PortDenied, PortNotFound

MISSING = {errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.ENOTDIR, errno.ECONNREFUSED}
BUSY = {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}
DENIED = {errno.EACCES, errno.EPERM}


def open_error(name: str, path: str, error: BaseException) -> DriverError:
    """What it means that the port ``name`` at ``path`` could not be opened; to be raised from ``error``."""
    where = f"port '{name}' at '{path}'"
    code = _errno(error)
    if code in MISSING:
        return PortNotFound(
            f"there is no {where} ({error}); connect the adapter, or give another path"
        )
    if code in BUSY:
        return PortBusy(f"{where} is in use by another program ({error}); close that one first")
    if code in DENIED:
        return PortDenied(
            f"this user may not use {where} ({error}); on Linux, join the group of the device"
        )
    return LinkBroken(f"{where} cannot be opened: {error}")


def _errno(error: BaseException | None) -> int | None:
    """Error number of the operating system in ``error`` or in what caused it."""
    while error is not None:
        if isinstance(error, OSError) and error.errno is not None:
            return error.errno
        error = error.__cause__ or error.__context__
    return None


def is_pseudo_terminal(path: str) -> bool:
    """Whether ``path`` leads to a pty: a program is at the other end, and no board resets."""
    return os.path.realpath(path).startswith("/dev/pts/")


class DeviceLock:
    """The exclusive lock on a terminal device, held until `release`.

    Taken before a port is opened, because opening an slcan adapter closes the CAN channel of
    whoever uses it. Paths that are no terminal device (URLs, Windows ports) are not locked.
    """

    def __init__(self) -> None:
        self._fd: int | None = None

    def acquire(self, path: str) -> None:
        """Take the lock; raises OSError (EAGAIN where another holds it)."""
        if os.name != "posix" or not Path(path).is_char_device():
            return
        import fcntl  # exists on POSIX only

        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(fd)
            raise
        self._fd = fd

    def release(self) -> None:
        """Let the lock go; harmless when it is not held."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
