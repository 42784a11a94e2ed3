"""The MCAP channels of a recording being written: which id carries which events.

Owns that an id stays the same in all parts, and that the sequence numbers of a topic go on
from part to part.
"""

from __future__ import annotations

from recordings import codec
from recordings.container import Container


class Topics:
    """Ids by kind of event and subject, registered at their first use."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self._schemas: dict[codec.Kind, int] = {}
        self._channels: dict[tuple[codec.Kind, str], int] = {}

    def find(self, kind: codec.Kind, subject: str) -> int | None:
        """The MCAP channel of a kind's events about ``subject``, or None where there was none yet."""
        return self._channels.get((kind, subject))

    def register(self, kind: codec.Kind, subject: str, sequence: int = 0) -> int:
        """A new MCAP channel, whose first message has this sequence number."""
        if kind not in self._schemas:
            data = codec.schema_data(kind)
            self._schemas[kind] = self._container.register_schema(kind.schema_name, data)
        channel_id = self._container.register_channel(
            kind.topic(subject), self._schemas[kind], sequence
        )
        self._channels[kind, subject] = channel_id
        return channel_id

    def received(self, channel: str) -> int:
        """Readings of a channel of the rig so far, in all parts."""
        channel_id = self.find(codec.READING, channel)
        return 0 if channel_id is None else self._container.sequence(channel_id)

    def readings(self) -> dict[int, str]:
        """Channels of the rig by the ids of their readings."""
        return {
            channel_id: subject
            for (kind, subject), channel_id in self._channels.items()
            if kind is codec.READING
        }

    def carried_to(self, container: Container) -> Topics:
        """The same ids in the next part."""
        topics = Topics(container)
        for (kind, subject), channel_id in self._channels.items():
            topics.register(kind, subject, self._container.sequence(channel_id))
        return topics
