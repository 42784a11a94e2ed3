"""The errors of this room: everything that can be wrong with a rig file or a recording.

Every message says what was seen, what was expected and what to do.
"""

from __future__ import annotations

from collections.abc import Mapping


class RecordingsError(Exception):
    """Root of what this room raises."""


class RigError(RecordingsError):
    """A rig description is not valid; names each key, what was found and what is allowed."""


class TableError(RecordingsError):
    """A table of poses cannot be read or does not fit its rig."""


class RecordingError(RecordingsError):
    """A recording cannot be written or read."""


class DiskFailed(RecordingError):
    """The disk is full or failed while a recording was written; it ends there.

    Attributes:
        lost: readings of each channel that were handed to the writer and are in no file.
    """

    def __init__(self, text: str, lost: Mapping[str, int]) -> None:
        self.lost = dict(lost)
        super().__init__(text)


class NotARecording(RecordingError):
    """The file is not a loopcal recording (foreign, empty, or not MCAP at all)."""


class NothingReadable(NotARecording):
    """The file holds nothing of a recording: it is empty, or not MCAP at all."""


class DamagedRecording(RecordingError):
    """The file is a recording, but it ends early or holds damaged parts."""


class HopelessRecording(DamagedRecording):
    """The file is a recording, but too damaged for any use of it."""
