"""What a CANopen device is to the link that serves it, and what the link is to the device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from drivers.can_bus import Frame
from drivers.canopen.sdo import Sdo
from drivers.link import JointDrive
from drivers.tally import Tally
from recordings.events import Event


@dataclass(frozen=True, slots=True)
class Identity:
    """What a device says that it is; ``problem`` is "" when that is what the rig expects."""

    text: str
    virtual: bool
    problem: str = ""


class Wire(Protocol):
    """What a device may do on its bus."""

    def now_ns(self) -> int:
        """Time of the session."""
        ...

    def send(self, cob_id: int, data: bytes) -> None:
        """Send a frame; raises LinkBroken or LinkClosed."""
        ...

    def sdo(self, node_id: int) -> Sdo:
        """Access to the object dictionary of a node."""
        ...


class CanopenDevice(Protocol):
    """A device on a CANopen bus.

    ``receive``, ``sync``, ``emergency`` and the tallies are used by whoever serves the bus,
    one thread at a time; they may not wait. ``identify`` and ``start`` may wait for answers.

    Attributes:
        name: device name of the rig.
        driver: driver name.
        node_id: 1 to 127.
        master_id: node id under which the device expects the master's heartbeat, or None.
        cob_ids: identifiers of the frames that it wants, beside EMCY and boot-up.
        tallies: of the channels that it delivers on each SYNC, by name.
        drive: the joint drive that it is, or None.
    """

    name: str
    driver: str
    node_id: int
    master_id: int | None
    cob_ids: tuple[int, ...]
    tallies: Mapping[str, Tally]
    drive: JointDrive | None

    def attach(self, wire: Wire) -> None:
        """Belong to a bus; called once, before anything else."""
        ...

    def identify(self) -> Identity:
        """Ask it who it is; raises DeviceSilent, DeviceRefused or LinkBroken."""
        ...

    def start(self) -> None:
        """Set it up and make it operational; again after each interruption. Raises as `identify`."""
        ...

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a frame; raises Malformed."""
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
