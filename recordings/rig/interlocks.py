"""Interlocks: what a session may never do with the joints of this rig, whatever its plan says.

Owns the ``[interlocks]`` table. Who watches over them, and how, is the business of `daq`.
"""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

from pydantic import Field, model_validator

from recordings.rig.quantity import COORDINATE, Described, Range, fail

DriveMode = Literal["off", "free", "position", "torque"]
"""What a drive can be told to do with its joint."""


class JointInterlock(Described):
    """What one joint may do.

    ``modes`` are those that its drive may be told; "off" always is. Its reading stays within
    ``travel`` (by default the joint's limits) and changes by no more than ``speed``. ``torque``
    is the largest share of the rated torque that mode "torque" may ask for; without it that
    mode is not allowed.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "travel": COORDINATE,
        "speed": ("deg_per_s", "rad_per_s", "m_per_s"),
        "torque": ("percent",),
    }

    name: str
    modes: tuple[str, ...] = ("off", "free", "position")
    travel: Range | None = None
    speed: float | None = None
    torque: float | None = None

    @model_validator(mode="after")
    def _values_make_sense(self) -> JointInterlock:
        for mode in self.modes:
            if mode not in get_args(DriveMode):
                allowed = ", ".join(get_args(DriveMode))
                raise fail(f"'modes' of '{self.name}' has '{mode}', expected some of: {allowed}")
        if self.speed is not None and self.speed <= 0:
            raise fail(f"'speed' of '{self.name}' is {self.speed}, expected above 0")
        if self.torque is not None and not 0 < self.torque <= 1:
            raise fail(
                f"'torque_percent' of '{self.name}' is {100 * self.torque:g}, "
                "expected above 0 and at most 100"
            )
        if "torque" in self.modes and self.torque is None:
            raise fail(f"'{self.name}' may be in mode \"torque\": say its 'torque_percent'")
        return self


class Together(Described):
    """At most ``at_most`` of ``joints`` may be in ``mode`` at the same time."""

    joints: tuple[str, ...]
    mode: Literal["free", "position", "torque"]
    at_most: int = Field(ge=0)

    @model_validator(mode="after")
    def _several_joints(self) -> Together:
        if len(set(self.joints)) < 2:
            raise fail(
                f"'together' names {', '.join(self.joints) or 'no joint'}; expected two or more"
            )
        return self


class Interlocks(Described):
    """The interlocks of a rig.

    ``arming`` is how long an arming lasts unless it is renewed; ``silence`` is how long a
    channel of a joint may deliver nothing while drives are powered.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"arming": ("s",), "silence": ("s",)}

    arming: float = 600.0
    silence: float = 1.0
    joints: tuple[JointInterlock, ...] = Field(alias="joint", default=())
    together: tuple[Together, ...] = ()

    def of(self, joint: str) -> JointInterlock:
        """What ``joint`` may do; the defaults where nothing is said of it."""
        found = (each for each in self.joints if each.name == joint)
        return next(found, JointInterlock(name=joint))

    @model_validator(mode="after")
    def _values_make_sense(self) -> Interlocks:
        for key, value in (("arming_s", self.arming), ("silence_s", self.silence)):
            if value <= 0:
                raise fail(f"'{key}' is {value}, expected above 0")
        names = [joint.name for joint in self.joints]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise fail(f"the interlocks name '{twice[0]}' twice; say all of a joint in one table")
        return self
