"""What a device on a CAN bus is to the link that serves it, and what the link is to the device.

A device names the identifiers of the frames that it wants and makes events of them. Identifiers
are integers; bit 31 marks one of 29 bits (`EXTENDED`), as in DBC files.

What has to run once a bus for all devices of one protocol (the master of CANopen) is a
`CanService`; devices name the class of theirs.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from drivers.can_bus import EXTENDED, Frame
from drivers.identity import Identity
from drivers.link import JointDrive, Losses
from drivers.tally import Tally
from recordings.events import Event
from recordings.faults import FaultKind

__all__ = ["EXTENDED", "CanDevice", "CanService", "CanWire", "Identity", "TakesBlocks"]


class CanWire(Protocol):
    """What a device may do on its bus."""

    def now_ns(self) -> int:
        """Time of the session."""
        ...

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame; raises LinkBroken or LinkClosed."""
        ...

    def await_answer(self, answers: queue.Queue[bytes], timeout_s: float) -> bytes:
        """Wait for an entry of ``answers`` while the bus is served.

        Raises:
            queue.Empty: none came in time.
            LinkBroken, LinkClosed: there is no bus.
        """
        ...

    def is_wanted(self, identifier: int) -> bool:
        """Whether a device of the rig, of any protocol, takes frames with this identifier."""
        ...

    def fault(self, time_ns: int, source: str, kind: FaultKind, text: str) -> None:
        """Report a fault that is no answer to a frame; repeated ones are summed up."""
        ...

    def restarted(self, device: CanDevice) -> None:
        """``device`` has booted: `CanDevice.start` it again, if it had been started."""
        ...


class CanParticipant(Protocol):
    """Who hears and sends frames. Called by whoever serves the bus, one thread at a time: may not wait.

    Attributes:
        name: whom a fault of its frames is about.
    """

    name: str

    @property
    def identifiers(self) -> Sequence[int]:
        """Of the frames that it wants."""
        ...

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take a frame; raises Malformed."""
        ...

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Send what is due, notice what is missing. Called at least every 0.05 s."""
        ...

    def due_ns(self) -> int | None:
        """When `serve` must be called next, None where it need not be."""
        ...


@runtime_checkable
class TakesBlocks(Protocol):
    """Who can take many frames of one identifier faster than one by one, in any order with others."""

    def receive_on(self, frames: Sequence[Frame]) -> Sequence[Event] | None:
        """Take frames of one identifier that came at the moment of the one before, given to `receive`.

        None, and nothing is taken, where they must be given to `receive` one by one. Nothing else
        comes of it than would of that.
        """
        ...


class CanDevice(CanParticipant, Protocol):
    """A device on a CAN bus. ``identify`` and ``start`` may wait for answers.

    Attributes:
        driver: driver name.
    """

    driver: str

    @property
    def channels(self) -> Sequence[str]:
        """Channels that it delivers."""
        ...

    @property
    def sends(self) -> bool:
        """Whether it needs the host to send frames; it is then refused where a port only listens."""
        ...

    @property
    def service(self) -> Callable[[str, Sequence[Any]], CanService] | None:
        """What runs once a bus for all devices of its protocol, or None."""
        ...

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """Of the channels that it delivers at each instant of the sampling schedule."""
        ...

    @property
    def drive(self) -> JointDrive | None:
        """The joint drive that it is, or None."""
        ...

    def attach(self, wire: Any) -> None:
        """Belong to a bus (a `CanWire`) or to its service; called once, before anything else."""
        ...

    def identify(self) -> Identity:
        """Ask it who it is; raises DeviceSilent, DeviceRefused or LinkBroken."""
        ...

    def start(self) -> None:
        """Set it up and make it operational; again after each interruption. Raises as `identify`."""
        ...

    def stop(self, now_ns: int) -> None:
        """Sampling has ended: what is missing from now on is no loss."""
        ...

    def interrupt(self) -> None:
        """The port has gone away; `start` will be called when it is back."""
        ...

    def losses(self, now_ns: int) -> Mapping[str, Losses]:
        """Losses of each channel so far."""
        ...


class CanService(CanParticipant, Protocol):
    """What runs once a bus for all devices of one protocol; made from the port's name and them."""

    def attach(self, wire: CanWire) -> None:
        """Belong to a bus, and attach the devices."""
        ...

    def open(self, now_ns: int) -> None:
        """The port has been opened by the program."""
        ...

    def sample(self, now_ns: int) -> Sequence[Event]:
        """An instant of the sampling schedule has come."""
        ...
