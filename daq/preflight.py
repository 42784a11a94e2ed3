"""Before anything is recorded or moved: does everything that the session needs answer?

Every port, device and channel is asked before one of them is complained about, so that one
look at the bench is enough.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from daq.errors import CannotRecord, NotArmed, NotReady, PlanNotPossible
from daq.interlocks import Interlocks
from daq.scale import scale_of
from drivers import DeviceStatus, DriverError, Link
from recordings.rig import Plan, Rig, Visit
from recordings.storage import Storage, room_in

MOST_SHOWN = 10
"""Violations of interlocks that one error names."""


def check_path(path: Path, storage: Storage) -> None:
    """Whether a recording can be made at ``path``; raises CannotRecord."""
    if path.exists():
        raise CannotRecord(
            f"'{path}' exists already, and a recording never replaces a file; "
            "choose another name or move it away"
        )
    if not path.parent.is_dir():
        raise CannotRecord(f"there is no folder '{path.parent}' for the recording; make it first")
    if (room := room_in(path.parent)) < storage.reserve_bytes:
        raise CannotRecord(
            f"the disk of '{path.parent}' has {room / 1e6:.1f} MB left, less than the reserve of "
            f"{storage.reserve_bytes / 1e6:.1f} MB that every recording keeps; make room first"
        )


def check_plan(rig: Rig, plan: Plan, stops: Sequence[Visit], interlocks: Interlocks) -> None:
    """Whether the rig describes all that ``plan`` needs, without looking at hardware.

    Args:
        rig: the rig.
        plan: the plan to be executed.
        stops: its visits.
        interlocks: what may not be.

    Raises:
        NotReady: channels without a device.
        PlanNotPossible: a target lies outside a count range, a joint to be driven has no
            channel or no drive, or the interlocks forbid it.
    """
    loose = [channel.name for channel in rig.channels if channel.device is None]
    if loose:
        raise NotReady(
            [f"channel '{name}': the rig names no device that delivers it" for name in loose]
        )
    moved = {device.joint for device in rig.devices}
    scales = {joint: scale_of(rig, joint) for joint in plan.drives}
    for joint in plan.drives:
        if joint not in moved:
            raise PlanNotPossible(f"the plan drives '{joint}', but no device of the rig moves it")
    for visit in stops:
        for joint, target in zip(plan.drives, visit.targets, strict=True):
            scales[joint].counts(target)
    if forbidden := interlocks.of_plan(plan, stops):
        raise PlanNotPossible(
            "the plan violates the interlocks of the rig; correct it:"
            + "".join(f"\n  {text}" for text in forbidden[:MOST_SHOWN])
            + (f"\n  and {len(forbidden) - MOST_SHOWN} more" if len(forbidden) > MOST_SHOWN else "")
        )


def check_drives(plan: Plan, joints: Collection[str]) -> None:
    """Whether every joint that ``plan`` drives has a drive that obeys; raises PlanNotPossible."""
    for joint in plan.drives:
        if joint not in joints:
            raise PlanNotPossible(
                f"the plan drives '{joint}', but its device only listens to another controller; "
                f"use a driver that commands, or a plan by hand"
            )


def open_all(links: Sequence[Link]) -> tuple[DeviceStatus, ...]:
    """Open every link and ask every device.

    Returns:
        the status of each device; all of them are ready.

    Raises:
        NotReady: it names every port that does not open and every device that does not
            answer or reports a problem, with the channels that depend on it.
    """
    missing: list[str] = []
    statuses: list[DeviceStatus] = []
    for link in links:
        try:
            link.open()
        except DriverError as error:
            missing.append(f"port '{link.name}': {error}")
            continue
        statuses += link.check()
    for status in statuses:
        if not status.answers or status.problem:
            why = status.problem or "it does not answer"
            carries = f", which delivers {', '.join(status.channels)}" if status.channels else ""
            missing.append(f"device '{status.name}' on port '{status.port}'{carries}: {why}")
    if missing:
        raise NotReady(missing)
    return tuple(statuses)


def arm_drives(
    rig: Rig,
    joints: Mapping[str, object],
    statuses: Sequence[DeviceStatus],
    arm: Callable[[tuple[str, ...]], bool],
) -> bool:
    """Ask for permission to move the joints that a real drive moves.

    A drive that says that it is virtual can hurt nobody and needs no arming.

    Args:
        rig: the rig; says which device moves which joint.
        joints: the joints with a drive.
        statuses: of all devices.
        arm: asked once, with the joints that real drives move; True permits.

    Returns:
        whether there are real drives, which are then armed.

    Raises:
        NotArmed: permission was refused.
    """
    virtual = {status.name for status in statuses if status.virtual}
    device_of = {device.joint: device.name for device in rig.devices if device.joint is not None}
    real = tuple(joint for joint in joints if device_of.get(joint) not in virtual)
    if real and not arm(real):
        raise NotArmed(
            f"arming of {', '.join(real)} was refused; nothing was moved and nothing recorded"
        )
    return bool(real)
