"""A file that a recording is read from: opened, and what can be wrong with it said in words.

Owns that a file which is not there, is no file, is nothing like MCAP or cannot be read is told
from one that is damaged. What is in it is for whoever takes the items.
"""

from __future__ import annotations

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from recordings.chunks import scan
from recordings.errors import NotARecording, NothingReadable, RecordingError
from recordings.items import Item
from recordings.records import MAGIC, Malformed


@dataclass(frozen=True, slots=True)
class Source:
    """An open file of ``size`` bytes."""

    size: int
    _file: BinaryIO

    def items(self) -> Iterator[Item]:
        """All that is in it; see `recordings.chunks.scan`."""
        return scan(self._file, self.size)

    @property
    def share(self) -> float:
        """How much of it has been read, 0 to 1."""
        return self._file.tell() / max(1, self.size)

    def is_closed(self) -> bool:
        """Whether it ends as a closed file does; to be asked before `items`."""
        self._file.seek(max(0, self.size - len(MAGIC)))
        return self._file.read(len(MAGIC)) == MAGIC and self.size > 2 * len(MAGIC)


@contextmanager
def opened(path: Path) -> Iterator[Source]:
    """The file at ``path``, for as long as it is read.

    Raises, also out of what reads it:
        NothingReadable: it is empty, or no MCAP file and nothing like one.
        NotARecording: there is no such file, or no file at all.
        RecordingError: the disk failed, or the file may not be read.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise NotARecording(f"'{path}' is not a file; expected a recording (MCAP)")
        with path.open("rb") as file:
            yield Source(status.st_size, file)
    except FileNotFoundError as error:
        raise NotARecording(f"there is no file '{path}'") from error
    except Malformed as error:
        what = "is empty" if status.st_size == 0 else f"is not an MCAP file: {error}"
        raise NothingReadable(f"'{path}' {what}; expected a recording") from error
    except OSError as error:
        raise RecordingError(f"cannot read '{path}': {error}") from error
