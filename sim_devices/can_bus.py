"""A classical CAN bus without its bits: frames, and the nodes that exchange them.

Owns what a frame is and who hears it. Refuses arbitration, bit timing and acknowledgement:
every frame arrives, at once and in order. Nodes hear the host's frames; they do not hear
each other, because no virtual node listens to another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

LARGEST_STANDARD_ID = 0x7FF
LARGEST_EXTENDED_ID = 0x1FFF_FFFF
LARGEST_LENGTH = 8


@dataclass(frozen=True, slots=True)
class Frame:
    """One classical CAN frame.

    Attributes:
        identifier: 11 bits, or 29 where ``extended``.
        data: up to 8 bytes; empty in a remote frame.
        extended: whether the identifier has 29 bits.
        remote_length: length code of a remote frame, None for a data frame.
    """

    identifier: int
    data: bytes = b""
    extended: bool = False
    remote_length: int | None = None


class CanNode(Protocol):
    """A device on the bus, told the time by whoever runs it [s since the bench started]."""

    def receive(self, frame: Frame, time_s: float) -> Sequence[Frame]:
        """Hear one frame; returns what the node sends at once."""

    def tick(self, time_s: float) -> Sequence[Frame]:
        """Let time pass; returns what became due. Called every few milliseconds."""


class CanBus:
    """The nodes of one bus, as a host on that bus meets them."""

    def __init__(self, nodes: Sequence[CanNode]) -> None:
        self._nodes = tuple(nodes)

    def receive(self, frame: Frame, time_s: float) -> list[Frame]:
        """What the nodes send when the host sends ``frame``, in the order of the nodes."""
        return [answer for node in self._nodes for answer in node.receive(frame, time_s)]

    def tick(self, time_s: float) -> list[Frame]:
        """What the nodes send because time has passed."""
        return [frame for node in self._nodes for frame in node.tick(time_s)]
