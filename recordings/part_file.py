"""One file of a recording being written: how it begins, and how it ends.

Owns what a file holds beside its messages: profile, rig, session, which part it is. The rig
and the session stand in it before the first chunk, behind it, and again at the end of a
large file, because without them nothing of the file could be used.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from recordings.container import Container
from recordings.errors import RecordingError
from recordings.part import NEXT_METADATA, PART_METADATA, Part, beginning, ending
from recordings.session import METADATA_NAME, SOFTWARE, Session, to_metadata
from recordings.storage import RecordingFile, Sync, disk_error

PROFILE = "loopcal"
RIG_ATTACHMENT = "rig.toml"

_LARGE = 128 * 1024
"""Size from which a lost piece of the disk can be as large as what is around both copies."""

_LAST_BYTES = 64 * 1024
"""Room for a last ledger and a word on why the file ends, with some to spare."""


class PartFile:
    """A file with its container. One thread at a time.

    Args:
        path: the file to create.
        rig_toml: the rig description.
        session: who records.
        part: which part of the recording it is.
        sync: when it is forced to the disk.

    Raises:
        RecordingError: the file exists already, or cannot be created; then there is none.
    """

    def __init__(self, path: Path, rig_toml: str, session: Session, part: Part, sync: Sync) -> None:
        self.path = path
        self.part = part
        self._rig_toml = rig_toml.encode("utf-8")
        self._session = session
        self._copied = False
        self._file = RecordingFile(path, sync)
        try:
            self.container = Container(self._file, PROFILE, SOFTWARE)
            self._describe()
            if part.number > 1:
                self.container.add_metadata(PART_METADATA, beginning(part))
            self._file.flushed(first=True)
        except OSError as error:
            self.discard()
            raise RecordingError(f"cannot create '{path}': {disk_error(error)}") from error
        self._file.hold_back = self._held_back

    def room(self) -> int:
        """Bytes by which the file can still grow."""
        return self._file.room()

    def flush(self) -> None:
        """Close the chunk and hand everything to the system; raises OSError where that fails."""
        self.container.end_chunk()
        self._copy()
        self._file.flushed()

    def finish(self, next_file: str = "") -> None:
        """End it with its summary; raises OSError where the disk fails, and may then be called again.

        Args:
            next_file: name of the part that follows, or "".
        """
        self.container.end_chunk()
        self._copy()
        if self.container.size > _LARGE:
            self._describe()
        self._file.hold_back = int
        if next_file:
            self.container.add_metadata(NEXT_METADATA, ending(self.part.number + 1, next_file))
        self.container.finish()
        self._file.close()

    def end_early(self) -> None:
        """The disk failed: what was held back for the end of the file may be used."""
        self._file.hold_back = int

    def leave(self) -> None:
        """Close it as it is, because the disk failed."""
        with contextlib.suppress(OSError):
            self._file.close()

    def discard(self) -> None:
        """Take away a file that nothing was recorded to."""
        self._file.discard()

    def _held_back(self) -> int:
        return self.container.ending_bytes + _LAST_BYTES

    def _describe(self) -> None:
        start_ns = self._session.start_ns
        self.container.attach(RIG_ATTACHMENT, "application/toml", self._rig_toml, start_ns)
        self.container.add_metadata(METADATA_NAME, to_metadata(self._session))

    def _copy(self) -> None:
        """Describe the recording again, once; not again where the disk has no room for it."""
        if not self._copied:
            self._copied = True
            self._describe()
