"""Makes a whole recording of what a damaged one still holds.

Owns what is taken over: every message that can be read, as it is and in its order, every
attachment and all metadata, and beside them a note of what was lost. The damaged files are
only read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings import columns
from recordings.chunks import scan
from recordings.codec import READING, decode, kind_of_topic
from recordings.container import Container
from recordings.definitions import Definitions
from recordings.errors import DiskFailed, HopelessRecording
from recordings.items import Block
from recordings.part import NEXT_METADATA, PART_METADATA
from recordings.part_file import PROFILE, RIG_ATTACHMENT
from recordings.rig import parse_rig
from recordings.session import METADATA_NAME, SOFTWARE, readable
from recordings.storage import RecordingFile, Sync, disk_error
from recordings.survey import Survey, survey
from recordings.survey_walk import RECOVERY_METADATA
from recordings.window import Records, Window
from recordings.wire import HEADER_SIZE

_SHOWN_LINES = 200


@dataclass(frozen=True, slots=True)
class Recovery:
    """What a recovery read and wrote.

    Attributes:
        found: the damaged recording, as far as it can be read.
        path: the new one.
        messages: messages written.
        size: bytes written.
    """

    found: Survey
    path: Path
    messages: int
    size: int


def recover(
    source: str | Path,
    target: str | Path,
    *,
    rig_toml: str | None = None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Recovery:
    """Write all that can be read of a recording, and of all its parts, to a new file.

    Args:
        source: the recording, or the first of its parts.
        target: the file to create.
        rig_toml: rig description for a recording that has lost its own; None where it has one.
        on_progress: takes the share of the work that is done, 0 to 1.

    Raises:
        NotARecording: as `survey`.
        HopelessRecording: nothing can be used of it.
        RigError: ``rig_toml`` is not a valid rig.
        RecordingError: ``target`` exists already or cannot be written, or ``source`` not be read;
            then there is no new file.
    """
    if rig_toml is not None:
        parse_rig(rig_toml, "the rig that was given")
    found = survey(source, lambda share: on_progress(share / 2))
    lost_rig_is_given = found.rig_toml is None and rig_toml is not None
    if found.hopeless and not (lost_rig_is_given and found.has_messages):
        raise HopelessRecording(f"'{source}': {found.hopeless}")
    file = RecordingFile(Path(target), Sync.CLOSE)
    try:
        messages, size = _copy(found, file, rig_toml, lambda share: on_progress((1 + share) / 2))
        file.close()
    except BaseException as error:
        file.discard()
        if isinstance(error, OSError):
            text = f"cannot write '{target}': {disk_error(error)}; it was taken away again"
            raise DiskFailed(text, {}) from error
        raise
    return Recovery(found, Path(target), messages, size)


def _copy(
    found: Survey,
    file: RecordingFile,
    rig_toml: str | None,
    on_progress: Callable[[float], None],
) -> tuple[int, int]:
    """Messages and bytes written."""
    definitions = found.definitions
    definitions.complete()
    container = Container(file, PROFILE, SOFTWARE)
    for schema in definitions.schemas.values():
        container.define_schema(schema)
    for channel in definitions.channels.values():
        container.define_channel(channel)
    rig = found.attachments.get(RIG_ATTACHMENT) or (rig_toml or "").encode("utf-8")
    start_ns = found.session.start_ns
    for name, data in {RIG_ATTACHMENT: rig, **found.attachments}.items():
        kind = "application/toml" if name == RIG_ATTACHMENT else "application/octet-stream"
        container.attach(name, kind, data, start_ns)
    session = readable(found.metadata.get(METADATA_NAME, {}))
    note = _note(found, rig_given=found.rig_toml is None)
    kept = {
        name: pairs
        for name, pairs in found.metadata.items()
        if name not in (METADATA_NAME, NEXT_METADATA, RECOVERY_METADATA)
        and (name != PART_METADATA or found.files[0].part.number > 1)
    }
    for name, pairs in {METADATA_NAME: session, RECOVERY_METADATA: note, **kept}.items():
        container.add_metadata(name, dict(pairs))
    messages = 0
    for number, each in enumerate(found.files):
        with each.path.open("rb") as source:
            window = Window()
            for item in scan(source, each.size):
                if isinstance(item, Block):
                    messages += _copy_records(window.add(item), container, definitions)
                    share = source.tell() / max(1, each.size)
                    on_progress((number + share) / len(found.files))
            messages += _copy_records(window.rest(), container, definitions)
    container.end_chunk()
    container.attach(RIG_ATTACHMENT, "application/toml", rig, start_ns)
    container.add_metadata(METADATA_NAME, session)
    container.finish()
    return messages, container.size


def _copy_records(taken: Records | None, container: Container, definitions: Definitions) -> int:
    """Messages copied: those that can be read, of channels that are known."""
    if taken is None:
        return 0
    found = columns.messages(taken.data, taken.offsets)
    time_ns = found.time_ns()
    kept = time_ns >= 0
    for channel_id in np.unique(found.channel_id).tolist():
        rows = np.flatnonzero(found.channel_id == channel_id)
        channel = definitions.channels.get(channel_id)
        kept[rows] &= channel is not None and _readable(found.take(rows), channel.topic)
    if not kept.all():
        found, time_ns = found.take(kept), time_ns[kept]
    start, stop = found.start - HEADER_SIZE, found.start + found.size
    container.add_copies(taken.data, start, stop, found.channel_id, time_ns)
    return len(start)


def _readable(found: columns.Messages, topic: str) -> NDArray[np.bool_]:
    """Which messages of one topic a reader can read; of a topic of others, all."""
    readable = np.ones(len(found), np.bool_)
    kind_and_subject = kind_of_topic(topic)
    if kind_and_subject is None:
        return readable
    kind, subject = kind_and_subject
    if kind is READING and columns.decode_readings(found)[1] == 0:
        return readable
    for row, time_ns in enumerate(found.time_ns().tolist()):
        try:
            decode(kind, subject, time_ns, found.payload(row))
        except ValueError:
            readable[row] = False
    return readable


def _note(found: Survey, *, rig_given: bool) -> dict[str, str]:
    """What the new recording says of the one it was made from."""
    lines = found.damage
    more = len(lines) - _SHOWN_LINES
    shown = [*lines[:_SHOWN_LINES], *([f"and {more} more"] if more > 0 else [])]
    lost = {
        f"missing/{topic}": str(tally.missing)
        for topic, tally in found.topics.items()
        if tally.missing
    }
    earlier = {f"earlier/{key}": value for key, value in found.recovery.items()}
    return {
        "source": " ".join(file.path.name for file in found.files),
        "source_bytes": str(sum(file.size for file in found.files)),
        "library": found.recovery.get("library") or found.files[0].library,
        "rig": "given" if rig_given else "recorded",
        "damage": "\n".join(shown),
        **lost,
        **earlier,
    }
