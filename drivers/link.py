"""The seam between drivers and a capture session: links, joint drives, device status, losses.

Owns what a session may know of a bus or line. Knows no protocol and no port.

Threads: `Link.pump` and `Link.losses` belong to one thread at a time. `JointDrive` methods
and `Link.check` may be called from any thread while another pumps, or while nobody does:
whoever waits for an answer serves the bus meanwhile, and what arrives is kept for the next
`pump`. `close` may be called from any thread and ends a `pump` that waits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from recordings.events import Event, Mode, ModeReport


class Clock(Protocol):
    """The time of a session."""

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch, on a monotonic clock anchored once to UTC."""
        ...


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """What one device answered when it was asked.

    Attributes:
        name: device name of the rig.
        driver: driver that speaks to it.
        port: port that it is on.
        channels: channels that it delivers.
        answers: whether it answered at all.
        identity: what it calls itself, "" where it did not say.
        virtual: whether it says that it is a simulation.
        problem: what is wrong and what to do, "" when it is ready.
    """

    name: str
    driver: str
    port: str
    channels: tuple[str, ...]
    answers: bool
    identity: str = ""
    virtual: bool = False
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Losses:
    """Readings of one channel so far that should have come and did not.

    ``expected`` minus the readings that `Link.pump` returned is always
    ``dropped_by_device + lost_in_gaps``: readings under way are not expected yet.

    Attributes:
        expected: instants of the sampling schedule, plus readings that came unasked.
        dropped_by_device: asked for over a working link, and never sampled or answered.
        lost_in_gaps: sampled and lost on the way (a step in the device's sample counter), or
            never asked for (the link was away, or `pump` was called too late).
        gaps: interruptions in which ``lost_in_gaps`` were lost.
    """

    expected: int
    dropped_by_device: int
    lost_in_gaps: int
    gaps: int


class JointDrive(Protocol):
    """A drive that moves one joint. Every method may be called from any thread.

    All methods raise DeviceSilent, DeviceRefused, LinkBroken or LinkClosed.
    """

    joint: str

    def set_mode(self, mode: Mode) -> None:
        """Switch to OFF, FREE (zero torque), POSITION (holding where it is) or TORQUE (at zero).

        OFF also acknowledges a fault. Any other mode is refused while the drive is in fault.
        """
        ...

    def move_to(self, target_raw: int) -> None:
        """Move to a target [counts]; raises BadCommand unless the mode is POSITION."""
        ...

    def set_torque(self, permille: int) -> None:
        """Set the torque [per mille of rated]; raises BadCommand unless the mode is TORQUE."""
        ...

    def vouch(self, until_ns: int) -> None:
        """Whoever supervises says that the drive need not trip before ``until_ns``.

        A drive with a watchdog is kept from tripping until then and no longer, whatever threads
        of the link still run. Never waits, never raises.
        """
        ...

    def report(self) -> ModeReport:
        """What the drive says it is doing, at most 0.2 s old."""
        ...


class Link(Protocol):
    """One bus or line with its devices.

    ``open``, ``check``, ``start``, many ``pump``, ``stop``, one more ``pump`` for what was
    under way, ``close``. A port that goes away between ``open`` and ``close`` is no error: it
    is reported as a Fault (kinds: `recordings.faults.FaultKind`), opened again when it is back,
    and what was lost meanwhile is counted.
    """

    name: str
    joints: Mapping[str, JointDrive]

    def open(self) -> None:
        """Open the port; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        ...

    def check(self) -> tuple[DeviceStatus, ...]:
        """Ask every device who it is. Never raises for a device that does not answer."""
        ...

    def start(self, sample_hz: float) -> None:
        """Begin to sample; raises DeviceSilent, DeviceRefused or LinkBroken."""
        ...

    def pump(self, timeout_s: float) -> Sequence[Event]:
        """Serve the port: send what is due, wait at most ``timeout_s``, return what came.

        Returns as soon as something came. A device that does not answer can make it last its
        reply timeout longer. Call it in a loop without sleeping.
        """
        ...

    def losses(self) -> Mapping[str, Losses]:
        """Losses of each channel, in step with the readings that `pump` has returned."""
        ...

    def stop(self) -> None:
        """End sampling, having waited shortly for answers under way; harmless when not started."""
        ...

    def close(self) -> None:
        """Let the port go; harmless when not open."""
        ...
