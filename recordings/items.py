"""What a scan of an MCAP file finds, one after the other. Knows nothing of loopcal."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Header:
    """The file's own header."""

    profile: str
    library: str


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file within the file."""

    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Metadata:
    """Named key-value pairs."""

    name: str
    pairs: dict[str, str]


@dataclass(frozen=True, slots=True)
class Block:
    """Schema, Channel and Message records, one behind the other, of what was found at byte ``offset``."""

    offset: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Damage:
    """What is wrong at byte ``offset``."""

    offset: int
    text: str

    def __str__(self) -> str:
        return f"byte {self.offset}: {self.text}"


Item = Header | Attachment | Metadata | Block | Damage
