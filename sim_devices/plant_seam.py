"""The seam between virtual devices and nature: all that a device may know of the plant."""

from __future__ import annotations

from typing import Literal, Protocol

PlantMode = Literal["off", "free", "position", "torque"]
"""What a drive makes of its joint: unpowered, zero torque, held at a target, pushed."""


class Plant(Protocol):
    """Nature, as the devices meet it. Called from one thread; times never go back."""

    def advance(self, time_s: float) -> None:
        """Move nature to this time of the session [s since the bench started]."""

    def sense(self, channel: str) -> int:
        """Raw counts of a channel of the rig now, noise included: two calls may differ."""

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        """What the drive of ``joint`` does from now on.

        Args:
            joint: a joint of the rig that a device moves.
            mode: one of `PlantMode`.
            target_raw: counts of the channel that senses the joint ("position"), per mille of
                rated torque ("torque"), otherwise 0.
        """

    def drive_fault(self, joint: str) -> int:
        """CiA 402 error code of what the joint does to its drive now, 0 when all is well."""
