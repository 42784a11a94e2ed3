"""A joint drive that is only listened to: what `drivers.can_device.CanDevice` asks and it has not.

For the drives of another controller: they deliver no channel and are sent nothing. A subclass
gives ``identifiers`` and ``receive``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from drivers.can_device import CanWire, Identity
from drivers.driver import DeviceSpec
from drivers.joint_drive import joint_of
from drivers.link import JointDrive, Losses
from drivers.tally import Tally
from recordings.events import Event


class PassiveDrive:
    """Never sends, never waits, delivers no channel.

    Args:
        spec: the device of the rig.
        instead: what a channel that names it as its device should do.

    Attributes:
        joint: the joint that it moves.

    Raises:
        OptionError: the rig says no joint, or names the device as that of a channel.
    """

    sends = False
    service = None
    drive: JointDrive | None = None
    channels: Sequence[str] = ()
    tallies: Mapping[str, Tally]

    def __init__(self, spec: DeviceSpec[Any], instead: str) -> None:
        self.joint = joint_of(spec, "listener", instead)
        self.name = spec.name
        self.driver = spec.driver
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
