"""The file that a recording is written to: how safe it is, and when the disk is nearly full.

Owns opening (never over another file), the fsync policy, the free space that is kept in
reserve, and writes that happen as a whole or not at all, so that a full disk leaves a file
that ends behind its last whole record. Knows nothing of what is written.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from recordings.errors import RecordingError

if sys.platform != "win32":
    import resource


class Sync(StrEnum):
    """When what was written is forced from the system's memory to the disk itself.

    It matters for power loss only: what was handed to the system survives a killed process.
    """

    FLUSH = "flush"
    """At every flush: power loss costs what a kill does."""
    CLOSE = "close"
    """When a file is complete."""
    NEVER = "never"
    """Whenever the system likes; on Linux that is within some 30 s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Storage:
    """How a recording is kept on disk.

    Attributes:
        sync: when it is forced to the disk.
        reserve_bytes: free space below which the writer says that the disk is nearly full.
        rotate_bytes: size at which a file ends and the next part begins, or None for one file.
        rotate_s: time after which a file ends [s], or None.

    Raises:
        RecordingError: a size or time that is not above 0.
    """

    sync: Sync = Sync.CLOSE
    reserve_bytes: int = 32_000_000
    rotate_bytes: int | None = None
    rotate_s: float | None = None

    def __post_init__(self) -> None:
        for what, value in (("size", self.rotate_bytes), ("duration", self.rotate_s)):
            if value is not None and not value > 0:
                raise RecordingError(f"the {what} of a part is {value}, expected more than 0")
        if self.reserve_bytes < 0:
            raise RecordingError(f"a reserve of {self.reserve_bytes} bytes, expected 0 or more")


class RecordingFile:
    """A new file that only grows. One thread at a time.

    Args:
        path: the file to create.
        sync: when it is forced to the disk.

    Attributes:
        hold_back: how many bytes of the disk every write must leave free.

    Raises:
        RecordingError: the file exists already, or cannot be created.
    """

    def __init__(self, path: Path, sync: Sync) -> None:
        self.path = path
        self._sync = sync
        self.hold_back: Callable[[], int] = int  # nothing
        self._size = 0
        self._broken = False
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError as error:
            raise RecordingError(
                f"'{path}' exists already, and a recording never replaces a file; "
                "choose another name or move it away"
            ) from error
        except OSError as error:
            raise RecordingError(f"cannot create the recording '{path}': {error}") from error

    def write(self, data: bytes) -> None:
        """Append all of ``data``, or nothing.

        Raises:
            OSError: the disk failed, or has no room for it and for what is held back; the file
                is as it was before.
        """
        if self._broken:
            raise OSError(errno.EIO, "an earlier write failed half-way", str(self.path))
        held_back = self.hold_back()
        if held_back and self.room() < len(data) + held_back:
            limited = largest_file() - self._size == self.room()
            code = errno.EFBIG if limited else errno.ENOSPC
            raise OSError(code, "the rest is held back for the end of the file", str(self.path))
        left = memoryview(data)
        try:
            while left:
                # A full disk takes what fits, and says so at the next write only.
                left = left[self._file.write(left) :]
        except OSError:
            try:
                self._file.truncate(self._size)
                self._file.seek(self._size)
            except OSError:
                self._broken = True
            raise
        self._size += len(data)

    def flushed(self, *, first: bool = False) -> None:
        """All that is to survive so far was written; raises OSError where the disk failed.

        Args:
            first: whether the file is new, so that its name in the folder is to survive too.
        """
        if self._sync is Sync.FLUSH:
            self._force(folder=first)

    def close(self) -> None:
        """Close it; does nothing when closed. Raises OSError where the disk failed."""
        if self._file.closed:
            return
        try:
            if self._sync is not Sync.NEVER:
                self._force(folder=True)
        finally:
            self._file.close()

    def discard(self) -> None:
        """Close it and take it away: nothing of use is in it."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _force(self, *, folder: bool) -> None:
        os.fsync(self._file.fileno())
        if not folder:
            return
        # Not every system lets a folder be opened; what is in the file is safe all the same.
        with contextlib.suppress(OSError):
            opened = os.open(self.path.absolute().parent, os.O_RDONLY)
            try:
                os.fsync(opened)
            finally:
                os.close(opened)

    def room(self) -> int:
        """Bytes by which the file can still grow."""
        # By the open file, where the system can: its folder may have been moved meanwhile.
        folder = self.path.absolute().parent
        free = room_in(folder if sys.platform == "win32" else self._file.fileno())
        return min(free, largest_file() - self._size)


def room_in(folder: Path | int) -> int:
    """Bytes free on the disk of ``folder``, or of an open file by its descriptor."""
    return shutil.disk_usage(folder).free


def largest_file() -> int:
    """Bytes that this process may write to one file."""
    if sys.platform == "win32":
        return sys.maxsize
    limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    return sys.maxsize if limit == resource.RLIM_INFINITY else limit


def disk_error(error: OSError) -> str:
    """What a failed write means and what to do, in words."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; make room, or record to another one"
    if error.errno == errno.EFBIG:
        return (
            "no file may be larger here (a limit of the file system or of this process); "
            "record in parts (`loopcal capture --rotate-mb`)"
        )
    return f"the disk failed: {error.strerror or error}"
