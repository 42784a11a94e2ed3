"""The bytes of a file one behind the other, with the CRC of all that were taken.

Owns the reading ahead, so that small records cost no call of the system each, and the CRC
is summed over long pieces. Holds one piece, or one record where that is longer. Knows
nothing of records.
"""

from __future__ import annotations

import zlib
from typing import BinaryIO

PIECE_BYTES = 1 << 20


class Stream:
    """Takes bytes from ``file`` from byte ``at`` on.

    Args:
        file: opened for reading in binary; seekable.
        at: where to begin.
        crc: CRC of what is before ``at``.
    """

    def __init__(self, file: BinaryIO, at: int, crc: int) -> None:
        self._file = file
        self._ahead = b""
        self._start = at  # of what is held, in the file
        self._next = 0  # in what is held
        self._summed = 0  # in what is held: up to here the CRC counts
        self._crc: int | None = crc
        file.seek(at)

    @property
    def at(self) -> int:
        """Offset in the file of the next byte."""
        return self._start + self._next

    @property
    def crc(self) -> int | None:
        """CRC of all that is before `at`; None once something was skipped."""
        if self._crc is not None and self._next > self._summed:
            part = memoryview(self._ahead)[self._summed : self._next]
            self._crc = zlib.crc32(part, self._crc)
        self._summed = self._next
        return self._crc

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes; fewer where the file ends."""
        if self._next + size > len(self._ahead):
            self._fill(size)
        data = self._ahead[self._next : self._next + size]
        self._next += len(data)
        return data

    def peek(self, size: int) -> bytes:
        """The next ``size`` bytes, which stay the next ones; fewer where the file ends."""
        if self._next + size > len(self._ahead):
            self._fill(size)
        return self._ahead[self._next : self._next + size]

    def held(self) -> tuple[bytes, int]:
        """What was read ahead, and where in it the next byte is."""
        return self._ahead, self._next

    def pass_over(self, size: int) -> None:
        """Take ``size`` bytes, without holding them all."""
        if self._next + size <= len(self._ahead):
            self._next += size
            return
        while size > 0:
            taken = len(self.take(min(size, PIECE_BYTES)))
            if not taken:
                return
            size -= taken

    def go_to(self, offset: int) -> None:
        """Go on at ``offset``; from then on there is no CRC."""
        self._crc = None
        self._ahead = b""
        self._start, self._next, self._summed = offset, 0, 0
        self._file.seek(offset)

    def _fill(self, size: int) -> None:
        """Hold at least ``size`` bytes more, if the file has them."""
        _ = self.crc
        kept = self._ahead[self._next :]
        self._start += self._next
        self._ahead = kept + self._file.read(max(PIECE_BYTES, size - len(kept)))
        self._next = self._summed = 0
