"""A closed loop of joints in step with a clock: what its drives do, what its sensors see.

The mechanism is quasi-static: no gravity, no inertia, no hand. Joints in position mode lead
it; free, unpowered and pushed ones follow the loop by least motion, so that with too few
joints in position mode the rest of it stays where it is. With too many, those engaged last
find no freedom left and can only follow; a drive whose joint strays from where it wants it
faults with following error 0x8611. So do the drives that lead into a joint limit or out of
reach, where the mechanism blocks. A target beyond its joint's own limits is refused with
0x8612. A drive with a fault holds nothing, until it is commanded "off".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np

from recordings.rig import Channel
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.loop import Loop
from sim_devices.plant.motion import Course, Profile, move
from sim_devices.plant.nature import Nature
from sim_devices.plant.quaternion import Array
from sim_devices.plant.seeds import ASSEMBLY, NOISE, stream
from sim_devices.plant.stop import FOLLOWING_ERROR, REFERENCE_LIMIT
from sim_devices.plant_seam import PlantMode

SPEED = 0.5
"""Speed of a drive where the rig has no plan that says [rad/s or m/s]."""
_WINDOW = {"angle": np.deg2rad(1.0), "length": 0.002}
"""How far a joint may stray from its drive before that faults, by dimension [rad, m]."""
_WINDOW_NOISES = 10.0
"""The window is at least this many standard deviations of its sensor's noise."""
_SUBSTEP_S = 0.02


@dataclass(slots=True)
class _Drive:
    """One driven joint.

    ``profile`` is where the drive wants its joint, while it holds it.
    """

    joint: int
    channel: Channel | None
    window: float
    profile: Profile | None = None
    fault: int = 0


class SerialPlant:
    """Nature of a serial rig in real time; a `sim_devices.plant_seam.Plant`.

    Args:
        nature: the rig as it really is.
        loop: its mechanism.

    Raises:
        MechanismDoesNotClose: there is no configuration to start from.
    """

    def __init__(self, nature: Nature, loop: Loop) -> None:
        rig = nature.rig
        places, seed = rig.mechanism.places, nature.truth.seed
        self._loop, self._sensors = loop, nature.sensors
        self._speed = rig.plan.move if rig.plan else SPEED
        self._column = {c.name: places.index(c.senses) for c in rig.channels if c.senses in places}
        self._rng = {c.name: stream(seed, NOISE, k) for k, c in enumerate(rig.channels)}
        self._drives: dict[str, _Drive] = {}
        for joint, place in enumerate(places):
            channel = rig.sensed_by(place)
            noise = channel.noise * abs(channel.gain.nominal) if channel else 0.0
            window = max(_WINDOW[rig.mechanism.dimension_of(place)], _WINDOW_NOISES * noise)
            self._drives[place] = _Drive(joint, channel, window)
        self._engaged: list[_Drive] = []
        self._leaders: list[_Drive] = []
        self._time_s = 0.0
        self._here = loop.assemble(stream(seed, ASSEMBLY))
        self._rates = np.zeros_like(self._here)

    @property
    def variables(self) -> Array:
        """(J,) joint variables now [rad or m]."""
        return self._here.copy()

    def advance(self, time_s: float) -> None:
        """Move nature to ``time_s``; a time that has passed changes nothing."""
        if time_s <= self._time_s:
            return
        before, since = self._here, self._time_s
        pieces = max(1, int(np.ceil((time_s - since) / _SUBSTEP_S)))
        for moment in np.linspace(since, time_s, pieces + 1)[1:]:
            self._time_s = float(moment)
            self._follow()
        self._rates = (self._here - before) / (time_s - since)

    def sense(self, channel: str) -> int:
        """Raw counts of ``channel`` now."""
        value = {name: self._here[[column]] for name, column in self._column.items()}
        rate = {name: self._rates[[column]] for name, column in self._column.items()}
        course = Course(np.array([self._time_s]), value, rate)
        return int(self._sensors[channel].counts(course, self._rng[channel])[0])

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        """What the drive of ``joint`` does from now on.

        Args:
            joint: any joint of the rig.
            mode: one of `sim_devices.plant_seam.PlantMode`; torque moves nothing here.
            target_raw: counts of the joint's channel in mode "position".

        Raises:
            CannotSimulate: position mode of a joint that no channel senses, or unknown mode.
        """
        drive = self._drives[joint]
        if mode == "position":
            self._aim(joint, drive, target_raw)
            return
        if mode not in get_args(PlantMode):
            raise CannotSimulate(f"the drive of '{joint}' was set to the unknown mode '{mode}'")
        if mode == "off":
            drive.fault = 0
        drive.profile = None
        self._engage()

    def drive_fault(self, joint: str) -> int:
        """CiA 402 error code of the drive of ``joint``, 0 when all is well."""
        return self._drives[joint].fault

    def _aim(self, joint: str, drive: _Drive, target_raw: int) -> None:
        if drive.channel is None:
            raise CannotSimulate(f"'{joint}' cannot be held in position: no channel senses it")
        if drive.fault:
            return
        wanted = self._sensors[drive.channel.name].value_at(target_raw)
        target = self._loop.clipped(drive.joint, wanted)
        if abs(target - wanted) > drive.window:
            self._fail(drive, REFERENCE_LIMIT)
            return
        now, profile = self._time_s, drive.profile
        start = (
            float(self._here[drive.joint]) if profile is None else float(profile.at(np.array(now)))
        )
        speed = 0.0 if profile is None else profile.speed_at(now)
        drive.profile = move(now, start, target, self._speed, speed)
        self._engage(drive)

    def _fail(self, drive: _Drive, code: int) -> None:
        drive.fault = code
        drive.profile = None
        self._engage()

    def _engage(self, added: _Drive | None = None) -> None:
        """Keep the list of drives that hold their joints, first come first, and who leads."""
        before = [drive.joint for drive in self._engaged]
        self._engaged = [drive for drive in self._engaged if drive.profile is not None]
        if added is not None and added not in self._engaged:
            self._engaged.append(added)
        joints = [drive.joint for drive in self._engaged]
        if joints != before:
            leading = self._loop.leaders(self._here, self._time_s, joints)
            self._leaders = [drive for drive in self._engaged if drive.joint in leading]

    def _follow(self) -> None:
        """Bring the mechanism to where the leading drives want it now, and judge all drives."""
        now = np.array(self._time_s)
        wanted = {d.joint: float(d.profile.at(now)) for d in self._engaged if d.profile}
        joints = [drive.joint for drive in self._leaders]
        target = np.array([wanted[joint] for joint in joints])
        if not self._loop.is_steady or not np.array_equal(self._here[joints], target):
            passed, _ = self._loop.follow(self._here, joints, target, self._time_s)
            held = np.isin(np.arange(len(self._here)), joints)
            closed, _ = self._loop.polish(passed[-1:], held, now[None])
            self._here = closed[0]
        for drive in list(self._engaged):
            if abs(wanted[drive.joint] - self._here[drive.joint]) > drive.window:
                self._fail(drive, FOLLOWING_ERROR)
