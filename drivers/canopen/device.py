"""What a CANopen node is to the master that serves it, and what the master is to the node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivers.can_device import CanDevice
from drivers.canopen.sdo import Sdo
from recordings.events import Event


class Wire(Protocol):
    """What a node may do on its bus."""

    def now_ns(self) -> int:
        """Time of the session."""
        ...

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame; raises LinkBroken or LinkClosed."""
        ...

    def sdo(self, node_id: int) -> Sdo:
        """Access to the object dictionary of a node."""
        ...

    def vouch(self, until_ns: int) -> None:
        """Send the master's heartbeat until then."""
        ...


class CanopenDevice(CanDevice, Protocol):
    """A node on a CANopen bus. Its identifiers are those of its PDOs.

    Attributes:
        node_id: 1 to 127.
        master_id: node id under which the device expects the master's heartbeat, or None.
    """

    node_id: int
    master_id: int | None

    def attach(self, wire: Wire) -> None:
        """Belong to a bus; called once, before anything else."""
        ...

    def sync(self, time_ns: int) -> Sequence[Event]:
        """A SYNC was sent."""
        ...

    def emergency(self, code: int, time_ns: int) -> Sequence[Event]:
        """It reported the error ``code`` (0: no error any more)."""
        ...

    def restarted(self) -> None:
        """It has booted: what it counted begins anew."""
        ...
