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
    "open": frozenset(FREEDOMS),
}
"""Freedoms that each named endpoint constraint leaves free and unsensed."""


POSE = ("x", "y", "z", "rx", "ry", "rz")
"""Parameters of a fixed transform: Tx(x) Ty(y) Tz(z) Rz(rz) Ry(ry) Rx(rx), URDF's xyz and rpy."""

_POSE_UNITS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("x", "y", "z"), LENGTH),
    **dict.fromkeys(("rx", "ry", "rz"), ANGLE),
}
_LENGTH, _ANGLE = Quantity(dimension="length"), Quantity(dimension="angle")
_UNIT = 1e-6  # how far from 1 the length of an axis may be
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

CONVENTIONS: dict[str, tuple[str, ...]] = {
    "dh": ("theta_offset", "s", "a", "alpha"),
    "hayati": ("theta_offset", "a", "alpha", "beta"),
    "urdf": POSE,
}
"""Parameters of a joint in each convention, in the order of the parameter table."""


class Joint(Described):
    """One joint and the link beside it.

    ``dh``: Rz(theta) Tz(s) Tx(a) Rx(alpha), one of theta and s moving; Denavit-Hartenberg as in
    Giugovaz & Hollerbach, Figure 1. A revolute joint turns theta = theta_offset + variable; a
    prismatic joint slides s = s + variable.

    ``hayati``: Rz(theta) Tx(a) Rx(alpha) Ry(beta), for neighbours that are nearly parallel, where
    Denavit-Hartenberg's s jumps with the smallest misalignment (Hayati, "Robot arm geometric
    link parameter estimation", 1983).

    ``urdf``: the joint's origin, as a fixed transform, and then the turn about, or the slide
    along, ``axis``.

    ``mass`` is that of the link behind the joint and ``com`` its centre, in the frame that the
    joint's transform ends in.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "theta_offset": ANGLE,
        "s": LENGTH,
        "a": LENGTH,
        "alpha": ANGLE,
        "beta": ANGLE,
        **_POSE_UNITS,
        "limits": COORDINATE,
        "home": COORDINATE,
        "mass": ("kg",),
        "com": LENGTH,
    }

    name: str
    type: Literal["revolute", "prismatic"] = "revolute"
    convention: Literal["dh", "hayati", "urdf"] = "dh"
    axis: Literal["x", "y", "z"] | tuple[float, float, float] = "z"
    theta_offset: Quantity = _ANGLE
    s: Quantity = _LENGTH
    a: Quantity = _LENGTH
    alpha: Quantity = _ANGLE
    beta: Quantity = _ANGLE
    x: Quantity = _LENGTH
    y: Quantity = _LENGTH
    z: Quantity = _LENGTH
    rx: Quantity = _ANGLE
    ry: Quantity = _ANGLE
    rz: Quantity = _ANGLE
    limits: Range | None = None
    home: Quantity = Quantity()
    mass: float | None = None
    com: tuple[float, float, float] | None = None

    @property
    def dimension(self) -> str:
        """What the joint variable measures."""
        return "angle" if self.type == "revolute" else "length"

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return CONVENTIONS[self.convention]

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector that it turns about or slides along, in the frame that its origin reaches."""
        return _AXES[self.axis] if isinstance(self.axis, str) else self.axis

    @model_validator(mode="after")
    def _keys_fit_the_convention(self) -> Joint:
        known = {part for parts in CONVENTIONS.values() for part in parts}
        for part in sorted((self.model_fields_set & known) - set(self.parts)):
            raise fail(
                f"'{part}' is no parameter of convention = \"{self.convention}\"; "
                f"that has: {', '.join(self.parts)}"
            )
        if self.convention == "hayati" and self.type == "prismatic":
            raise fail('a prismatic joint has no convention "hayati"; use "dh" or "urdf"')
        if "axis" in self.model_fields_set and self.convention != "urdf":
            raise fail("'axis' is given only with convention = \"urdf\"; others move about z")
        length = sum(part**2 for part in self.direction) ** 0.5
        if abs(length - 1.0) > _UNIT:
            raise fail(f"'axis' has the length {length:.6g}, expected a unit vector")
        return self

    @model_validator(mode="after")
    def _mass_has_a_place(self) -> Joint:
        if self.mass is not None and self.mass < 0:
            raise fail(f"'mass_kg' of the joint '{self.name}' is {self.mass}, expected 0 or above")
        if (self.mass is None) != (self.com is None):
            raise fail(
                f"the joint '{self.name}' gives one of 'mass_kg' and 'com_m'; "
                "a link's weight needs both"
            )
        return self

    @model_validator(mode="after")
    def _units_fit_the_joint(self) -> Joint:
        for key, given in (("limits", self.limits), ("home", self.home)):
            if given is not None and given.dimension not in ("", self.dimension):
                raise fail(
                    f"'{key}' of the {self.type} joint '{self.name}' is given as {given.dimension}, "
                    f"expected {self.dimension}"
                )
        return self


class Tip(Described):
    """The fixed transform from the last joint's link to the endpoint that is held."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = _POSE_UNITS

    x: Quantity = _LENGTH
    y: Quantity = _LENGTH
    z: Quantity = _LENGTH
    rx: Quantity = _ANGLE
    ry: Quantity = _ANGLE
    rz: Quantity = _ANGLE


class Fixture(Described):
    """A place in the environment that holds the endpoint, as a pose in the frame where the chain starts."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = _POSE_UNITS

    name: str
    x: Quantity = _LENGTH
    y: Quantity = _LENGTH
    z: Quantity = _LENGTH
    rx: Quantity = _ANGLE
    ry: Quantity = _ANGLE
    rz: Quantity = _ANGLE


class Distance(Described):
    """A known distance between the origins of two fixtures, with its standard uncertainty."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"distance": LENGTH}

    between: tuple[str, str]
    distance: Quantity

    @model_validator(mode="after")
    def _is_a_measurement(self) -> Distance:
        given = self.distance
        if given.tie is not None or given.identify or given.uncertainty is None:
            raise fail(
                "a distance between fixtures is { nominal = ..., uncertainty = ... }: "
                "a measurement, not a parameter"
            )
        if not given.nominal > 0 or self.between[0] == self.between[1]:
            raise fail("a distance lies between two different fixtures and is above 0")
        return self


class Closure(Described):
    """How the end of the chain meets its start: which endpoint freedoms stay free and unsensed."""

    constraint: Literal["rigid", "hinge", "slider", "ball", "plane", "open", "custom"] = "rigid"
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
    """A chain of joints that is closed through its surroundings.

    Without fixtures the chain ends where it starts: the product of all joint transforms, and of
    ``tip``, is I up to the freedoms of the closure. With fixtures it ends in one of them at every
    pose: fixture_from_tip is free in those freedoms, along and about the fixture's axes, and
    zero in the others.

    Unsensed joints (a hinge in the fixture) are joints of the chain without a channel. The
    arm's base frame lies behind the joint called ``base``, or at the start of the chain.

    ``standing = "gravity-compensated"``: while the arm stands, every joint's drive carries just
    the weight of what its joint moves, as in hand guiding, and the fixture bears nothing. Else the
    drives that the session says are holding carry it, and the fixture with them.
    """

    family: Literal["serial"]
    joints: tuple[Joint, ...] = Field(alias="joint", min_length=1)
    tip: Tip | None = None
    closure: Closure = Closure()
    fixtures: tuple[Fixture, ...] = Field(alias="fixture", default=())
    distances: tuple[Distance, ...] = Field(alias="distance", default=())
    base: str | None = None
    standing: Literal["on-drives", "gravity-compensated"] = "on-drives"

    @property
    def places(self) -> tuple[str, ...]:
        """What a channel of this mechanism can sense."""
        return tuple(joint.name for joint in self.joints)

    @property
    def fixture_names(self) -> tuple[str, ...]:
        """Names of the fixtures; empty where the chain ends where it starts."""
        return tuple(fixture.name for fixture in self.fixtures)

    @model_validator(mode="after")
    def _base_is_a_joint(self) -> SerialMechanism:
        names = [joint.name for joint in self.joints]
        if self.base is not None and self.base not in names:
            raise fail(f"'base' is '{self.base}', expected one of: {', '.join(names)}")
        return self

    @model_validator(mode="after")
    def _distances_lie_between_fixtures(self) -> SerialMechanism:
        for distance in self.distances:
            for end in distance.between:
                if end not in self.fixture_names:
                    known = ", ".join(self.fixture_names) or "(there are none)"
                    raise fail(f"a distance ends at '{end}', expected one of: {known}")
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

    ``leg_readings = "change"``: what a leg's channel senses is not its length but its length
    minus that at the neutral pose (line encoders set to zero there).

    ``plate_mass`` with its centre ``plate_com`` in the plate frame is what the legs carry while
    the plate stands; ``standing = "held-by-hand"`` says that a hand carries it instead.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "plate_mass": ("kg",),
        "plate_com": LENGTH,
    }

    family: Literal["platform"]
    plate: Literal["pivoted", "free", "point"]
    base_points: tuple[Point, ...] = Field(alias="base_point", min_length=1)
    plate_points: tuple[Point, ...] = Field(alias="plate_point", min_length=1)
    legs: tuple[Leg, ...] = Field(alias="leg", min_length=1)
    neutral: Neutral = Neutral()
    leg_readings: Literal["length", "change"] = "length"
    plate_mass: float | None = None
    plate_com: tuple[float, float, float] | None = None
    standing: Literal["on-legs", "held-by-hand"] = "on-legs"

    @property
    def places(self) -> tuple[str, ...]:
        """What a channel of this mechanism can sense."""
        return tuple(leg.name for leg in self.legs)

    def dimension_of(self, place: str) -> str:
        """What a channel at ``place`` measures: every leg is a length."""
        return "length"

    @model_validator(mode="after")
    def _plate_mass_has_a_place(self) -> PlatformMechanism:
        if self.plate_mass is not None and self.plate_mass < 0:
            raise fail(f"'plate_mass_kg' is {self.plate_mass}, expected 0 or above")
        if (self.plate_mass is None) != (self.plate_com is None):
            raise fail("give both 'plate_mass_kg' and 'plate_com_m', or neither")
        return self

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
