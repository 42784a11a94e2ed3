"""The files of one recording being written: the one that is open, and when the next is due.

Owns their names, and that a file of an older recording is never taken for a part of this one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from recordings.errors import RecordingError
from recordings.part import FIRST_PART, Part, old_parts, part_path
from recordings.part_file import PartFile
from recordings.session import Session
from recordings.storage import Storage

_SECOND = 1_000_000_000


class Series:
    """One thread at a time.

    Args:
        first: the file to create first.
        rig_toml: the rig description.
        session: who records.
        storage: how the files are kept on disk, and when each ends.

    Attributes:
        file: the one that is being written.

    Raises:
        RecordingError: the file, or a part of this name, exists already; or it cannot be created.
    """

    def __init__(self, first: Path, rig_toml: str, session: Session, storage: Storage) -> None:
        self._first = first
        self._rig_toml = rig_toml
        self._session = session
        self._storage = storage
        self._rotates = storage.rotate_bytes is not None or storage.rotate_s is not None
        if self._rotates:
            for path in old_parts(first):
                raise RecordingError(
                    f"'{path}' exists already, and would be taken for a part of '{first}'; choose "
                    "another name or move it away"
                )
        self.file = self._open(FIRST_PART)
        self.begun(session.start_ns)

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files so far, in order."""
        numbers = range(1, self.file.part.number + 1)
        return tuple(part_path(self._first, number) for number in numbers)

    @property
    def nearly_full(self) -> str:
        """What to tell the operator where the disk has less room than the reserve, or ""."""
        room = self.file.room()
        if room >= self._storage.reserve_bytes:
            return ""
        return (
            f"the disk is nearly full: '{self.file.path}' can grow by {room / 1e6:.1f} MB, "
            f"less than the reserve of {self._storage.reserve_bytes / 1e6:.1f} MB; make room, "
            "or record to another disk"
        )

    def is_due(self, time_ns: int) -> bool:
        """Whether the next file is to be begun, at ``time_ns`` of the recording."""
        if not self._rotates:
            return False
        size, seconds = self._storage.rotate_bytes, self._storage.rotate_s
        written = self.file.container.size
        due = size is not None and written >= size
        due |= seconds is not None and time_ns - self._begun_ns >= seconds * _SECOND
        return due and written > self._begun_bytes

    def next_file(self, received_before: Mapping[str, int]) -> PartFile:
        """The next file, which is not the one being written yet.

        Args:
            received_before: readings of each channel so far.

        Raises:
            RecordingError: it cannot be created; then there will be no further one, because a part
                that is too long is better than none.
        """
        part = Part(
            number=self.file.part.number + 1,
            previous_file=self.file.path.name,
            received_before=received_before,
        )
        try:
            return self._open(part)
        except RecordingError:
            self._rotates = False
            raise

    def begun(self, time_ns: int) -> None:
        """The file holds what every part begins with, at ``time_ns``."""
        self._begun_ns = time_ns
        self._begun_bytes = self.file.container.size

    def _open(self, part: Part) -> PartFile:
        path = part_path(self._first, part.number)
        return PartFile(path, self._rig_toml, self._session, part, self._storage.sync)
