"""A CAN device that is only listened to: what `drivers.can_device.CanDevice` asks and it has not.

For devices that deliver no channel and are sent nothing, such as the drives of another
controller. A subclass gives ``identifiers``, ``driver``, ``name`` and ``receive``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.can_device import CanWire, Identity
from drivers.link import JointDrive, Losses
from drivers.tally import Tally
from recordings.events import Event


class PassiveDevice:
    """Never sends, never waits, delivers no channel."""

    sends = False
    service = None
    drive: JointDrive | None = None
    channels: Sequence[str] = ()
    tallies: Mapping[str, Tally]
    name: str
    driver: str

    def __init__(self, name: str, driver: str) -> None:
        self.name = name
        self.driver = driver
        self.tallies = {}

    def attach(self, wire: CanWire) -> None:
        """Belong to a bus."""
        self._wire = wire

    def identify(self) -> Identity:
        """It cannot be asked; another controller need not have begun yet."""
        return Identity("listened to", virtual=False)

    def start(self) -> None:
        """Nothing is set up."""

    def stop(self, now_ns: int) -> None:
        """It delivers no channel."""

    def interrupt(self) -> None:
        """The port has gone away."""

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """It delivers no channel."""
        return {}

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Nothing is sent."""
        return ()

    def due_ns(self) -> int | None:
        """Nothing is sent."""
        return None
