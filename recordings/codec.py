"""Events <-> topics and protobuf payloads.

Owns which topic carries which event, and what a message must say to be one. Pure: bytes
and values, no file. Readings have a fast path of their own in `recordings.readings`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError, Message

from recordings import events, messages_pb2
from recordings.events import Event, Mode, ReadingFlag, SessionState


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of event on file: its class, its message, its topics.

    Attributes:
        event: the dataclass of `recordings.events`.
        message: the protobuf message of the same name.
        prefix: what its topics begin with.
        suffix: what its topics end with.
        subject: event field that the topic names between the two, or None for a single topic.
    """

    event: type[Event]
    message: type[Message]
    prefix: str
    suffix: str = ""
    subject: str | None = None

    @property
    def schema_name(self) -> str:
        """Full name of the protobuf message."""
        return str(self.message.DESCRIPTOR.full_name)

    def topic(self, subject: str) -> str:
        """The topic of this kind's events about ``subject``."""
        return f"{self.prefix}{subject}{self.suffix}"

    def subject_of(self, topic: str) -> str | None:
        """What ``topic`` is about ("" for a single topic), or None where it is not of this kind."""
        if self.subject is None:
            return "" if topic == self.prefix else None
        inner = topic.removeprefix(self.prefix).removesuffix(self.suffix)
        return inner if inner and self.topic(inner) == topic else None


READING = Kind(events.Reading, messages_pb2.Reading, "/channel/", subject="channel")
KINDS = (
    READING,
    Kind(events.ModeCommand, messages_pb2.ModeCommand, "/joint/", "/command", "joint"),
    Kind(events.ModeReport, messages_pb2.ModeReport, "/joint/", "/mode", "joint"),
    Kind(events.Dwell, messages_pb2.Dwell, "/session/dwell"),
    Kind(events.Mark, messages_pb2.Mark, "/session/mark"),
    Kind(events.Fault, messages_pb2.Fault, "/session/fault"),
    Kind(events.StateChange, messages_pb2.StateChange, "/session/state"),
    Kind(events.ClockSample, messages_pb2.ClockSample, "/clock/", subject="source"),
    Kind(events.RoundTrip, messages_pb2.RoundTrip, "/round_trip/", subject="source"),
    Kind(events.LedgerEntry, messages_pb2.LedgerEntry, "/ledger/", subject="source"),
)
"""Every kind of event, in the order in which their schemas are registered."""

_TYPES: dict[str, type[Mode] | type[ReadingFlag] | type[SessionState]] = {
    "mode": Mode,
    "flags": ReadingFlag,
    "before": SessionState,
    "after": SessionState,
}
_OF_EVENT = {kind.event: kind for kind in KINDS}


def kind_of(event: Event) -> Kind:
    """The kind of ``event``."""
    return _OF_EVENT[type(event)]


def kind_of_topic(topic: str) -> tuple[Kind, str] | None:
    """Kind and subject of ``topic``, or None for a topic that is not part of the format."""
    for kind in KINDS:
        if (subject := kind.subject_of(topic)) is not None:
            return kind, subject
    return None


def schema_data(kind: Kind) -> bytes:
    """The FileDescriptorSet that MCAP calls the schema of a protobuf message."""
    described = FileDescriptorSet()
    kind.message.DESCRIPTOR.file.CopyToProto(described.file.add())
    return described.SerializeToString(deterministic=True)


def encode(event: Event) -> bytes:
    """The payload of ``event``. Its time and its topic's subject are not part of it.

    Raises:
        ValueError: a number does not fit its field.
    """
    message = kind_of(event).message()
    for name in message.DESCRIPTOR.fields_by_name:
        value = getattr(event, name)
        if value is not None:
            setattr(message, name, value)
    return message.SerializeToString(deterministic=True)


def decode(kind: Kind, subject: str, time_ns: int, payload: bytes) -> Event:
    """The event that ``payload`` holds; the inverse of `encode`.

    Raises:
        ValueError: not such a message, or a required field is absent; says which.
    """
    message = kind.message()
    try:
        message.ParseFromString(payload)
    except DecodeError as error:
        raise ValueError(f"not a {kind.schema_name} message") from error
    values: dict[str, Any] = {"time_ns": time_ns}
    if kind.subject is not None:
        values[kind.subject] = subject
    present = {field.name: value for field, value in message.ListFields()}
    for name, typed, absent in _fields_of(kind):
        value = present.get(name, absent)
        if value is MISSING:
            raise ValueError(f"a {kind.schema_name} message without '{name}'")
        values[name] = value if typed is None or value is absent else typed(value)
    return kind.event(**values)


@cache
def _fields_of(kind: Kind) -> tuple[tuple[str, Callable[[int], Any] | None, Any], ...]:
    """Name of each field, its type where it is not the message's own, and what it is when absent."""
    return tuple(
        (
            field.name,
            _TYPES.get(field.name),
            None if str(field.type).endswith("| None") else field.default,
        )
        for field in fields(kind.event)
        if field.name not in ("time_ns", kind.subject)
    )
