"""The two mechanism families a rig file can describe: what closes the loop, and its geometry.

Owns names, nominal values and structure. Kinematics lives in `solver.mechanism` and, on
its own, in `sim_devices`: this file computes nothing.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from recordings.rig.quantity import ANGLE, COORDINATE, LENGTH, Described, Quantity, Range, fail

FREEDOMS = ("x", "y", "z", "rx", "ry", "rz")
"""The six endpoint freedoms, along and about the axes of the closing frame."""

CONSTRAINTS: dict[str, frozenset[str]] = {
    "rigid": frozenset(),
    "hinge": frozenset({"rz"}),
    "slider": frozenset({"z"}),
    "ball": frozenset({"rx", "ry", "rz"}),
    "plane": frozenset({"x", "y", "rz"}),
}
"""Freedoms that each named endpoint constraint leaves free and unsensed."""


class Joint(Described):
    """One joint and the link behind it: Rz(theta) Tz(s) Tx(a) Rx(alpha), one of theta and s moving.

    Denavit-Hartenberg as in Giugovaz & Hollerbach, Figure 1. A revolute joint turns
    theta = theta_offset + variable; a prismatic joint slides s = s + variable.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "theta_offset": ANGLE,
        "s": LENGTH,
        "a": LENGTH,
        "alpha": ANGLE,
        "limits": COORDINATE,
        "home": COORDINATE,
    }

    name: str
    type: Literal["revolute", "prismatic"] = "revolute"
    theta_offset: Quantity = Quantity(dimension="angle")
    s: Quantity = Quantity(dimension="length")
    a: Quantity = Quantity(dimension="length")
    alpha: Quantity = Quantity(dimension="angle")
    limits: Range | None = None
    home: Quantity = Quantity()

    @property
    def dimension(self) -> str:
        """What the joint variable measures."""
        return "angle" if self.type == "revolute" else "length"

    @model_validator(mode="after")
    def _units_fit_the_joint(self) -> Joint:
        for key, given in (("limits", self.limits), ("home", self.home)):
            if given is not None and given.dimension not in ("", self.dimension):
                raise fail(
                    f"'{key}' of the {self.type} joint '{self.name}' is given as {given.dimension}, "
                    f"expected {self.dimension}"
                )
        return self


class Closure(Described):
    """How the end of the chain meets its start: which endpoint freedoms stay free and unsensed."""

    constraint: Literal["rigid", "hinge", "slider", "ball", "plane", "custom"] = "rigid"
    free: tuple[Literal["x", "y", "z", "rx", "ry", "rz"], ...] | None = None

    @model_validator(mode="after")
    def _free_belongs_to_custom(self) -> Closure:
        if (self.constraint == "custom") != (self.free is not None):
            raise fail(
                "'free' lists the freedoms of constraint = \"custom\", and is given only with it"
            )
        return self

    @property
    def freedoms(self) -> frozenset[str]:
        """Endpoint freedoms left free, out of `FREEDOMS`."""
        return frozenset(self.free) if self.free is not None else CONSTRAINTS[self.constraint]


class SerialMechanism(Described):
    """A chain of joints that ends where it starts: the product of all joint transforms is I.

    Unsensed joints (a hinge in the fixture) are joints of the chain without a channel. The
    arm's base frame lies behind the joint called ``base``, or at the start of the chain.
    """

    family: Literal["serial"]
    joints: tuple[Joint, ...] = Field(alias="joint", min_length=1)
    closure: Closure = Closure()
    base: str | None = None

    @property
    def places(self) -> tuple[str, ...]:
        """What a channel of this mechanism can sense."""
        return tuple(joint.name for joint in self.joints)

    @model_validator(mode="after")
    def _base_is_a_joint(self) -> SerialMechanism:
        names = [joint.name for joint in self.joints]
        if self.base is not None and self.base not in names:
            raise fail(f"'base' is '{self.base}', expected one of: {', '.join(names)}")
        return self

    def dimension_of(self, place: str) -> str:
        """What a channel at ``place`` measures."""
        return next(joint.dimension for joint in self.joints if joint.name == place)


class Point(Described):
    """A leg end, in the base frame or in the plate frame."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"x": LENGTH, "y": LENGTH, "z": LENGTH}

    name: str
    x: Quantity
    y: Quantity
    z: Quantity


class Leg(Described):
    """A straight leg of sensed length between a base point and a plate point."""

    name: str
    base: str
    plate: str


class Neutral(Described):
    """Plate pose in the middle of its workspace, base from plate: Rz(rz) Ry(ry) Rx(rx), then x, y, z."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "rx": ANGLE,
        "ry": ANGLE,
        "rz": ANGLE,
        "x": LENGTH,
        "y": LENGTH,
        "z": LENGTH,
    }

    rx: float = 0.0
    ry: float = 0.0
    rz: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class PlatformMechanism(Described):
    """Points on a base, points on a plate, legs of sensed length between them.

    ``plate = "pivoted"``: the plate turns about the common origin of both frames (three
    freedoms); ``"free"``: it moves in six; ``"point"``: plate points coincide and only
    translate (three freedoms, a cable machine).
    """

    family: Literal["platform"]
    plate: Literal["pivoted", "free", "point"]
    base_points: tuple[Point, ...] = Field(alias="base_point", min_length=1)
    plate_points: tuple[Point, ...] = Field(alias="plate_point", min_length=1)
    legs: tuple[Leg, ...] = Field(alias="leg", min_length=1)
    neutral: Neutral = Neutral()

    @property
    def places(self) -> tuple[str, ...]:
        """What a channel of this mechanism can sense."""
        return tuple(leg.name for leg in self.legs)

    def dimension_of(self, place: str) -> str:
        """What a channel at ``place`` measures: every leg is a length."""
        return "length"

    @model_validator(mode="after")
    def _legs_end_at_points(self) -> PlatformMechanism:
        base = [point.name for point in self.base_points]
        plate = [point.name for point in self.plate_points]
        for leg in self.legs:
            for end, known in ((leg.base, base), (leg.plate, plate)):
                if end not in known:
                    raise fail(
                        f"leg '{leg.name}' ends at '{end}', expected one of {', '.join(known)}"
                    )
        return self
