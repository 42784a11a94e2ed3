"""The errors of this room: everything that can be wrong with a rig file or a recording.

Every message says what was seen, what was expected and what to do.
"""


class RecordingsError(Exception):
    """Root of what this room raises."""


class RigError(RecordingsError):
    """A rig description is not valid; names each key, what was found and what is allowed."""


class TableError(RecordingsError):
    """A table of poses cannot be read or does not fit its rig."""


class RecordingError(RecordingsError):
    """A recording cannot be written or read."""


class NotARecording(RecordingError):
    """The file is not a loopcal recording (foreign, empty, or not MCAP at all)."""


class DamagedRecording(RecordingError):
    """The file is a recording, but it ends early or holds damaged parts."""
