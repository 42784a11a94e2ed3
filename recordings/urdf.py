"""URDF in and out: a rig from the chain between two links, and the document with calibrated origins.

Owns the two texts; what a chain is made of knows `recordings.urdf_chain`. Moving joints
become joints of convention ``urdf``; fixed ones are folded into the origin behind them, and
those behind the last moving joint into ``tip``. Where an origin's ry is a right angle, turns about
x and z are the same, and small errors of the three angles do not reach every small rotation; the rig's
frame of that joint is then the URDF's with its axes permuted, which keeps every ry away from it.
What the links weigh, with all that hangs on them, becomes the joints' masses; meshes and inertias
are left.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from recordings.errors import RigError
from recordings.rig.mechanism import CONSTRAINTS, POSE
from recordings.rig.rig import parse_rig
from recordings.sought import sought, with_level_x
from recordings.urdf_chain import (
    MOVING,
    Link,
    axis_of,
    chain_to,
    home_of,
    moved,
    parsed,
    pose_of,
    transform_of,
)

Array = NDArray[np.float64]

COUNT = 1e-9
"""Size of a count in rigs and recordings made from tables [rad, m]: nothing an encoder knows is lost."""

GRAVITY = 9.80665
"""[m/s^2], down the z axis of the URDF's root where links have masses."""

_STEEP = 0.1  # |cos ry| below which they are too nearly the same for a rig
_NONE = np.eye(4)
_CYCLED = _NONE[:, [1, 2, 0, 3]]  # x, y, z become y, z, x: 120 deg about (1, 1, 1)
_ASIDE = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # 90 deg about z


@dataclass(frozen=True, slots=True, kw_only=True)
class Doubts:
    """What a rig from a URDF does not know exactly; a width of 0 leaves that part as it is.

    Attributes:
        length_m: standard uncertainty of each x, y, z of an origin.
        angle_rad: of each rx, ry, rz of an origin.
        encoder_rad: of each joint's zero [rad, or m for a slide].
        noise_rad: standard deviation of one joint reading [rad or m].
        tip: whether the tip is uncertain as well.
    """

    length_m: float = 2e-3
    angle_rad: float = 10e-3
    encoder_rad: float = 0.0
    noise_rad: float = 2e-4
    tip: bool = True


def rig_from_urdf(
    text: str,
    tip: str,
    constraint: str,
    *,
    fixtures: Sequence[str] = ("fixture",),
    doubts: Doubts | None = None,
    gravity_compensated: bool = False,
) -> str:
    """The TOML text of a rig for the chain from the root of a URDF to the link ``tip``.

    Channels are called q1, q2, ... from the root on, in counts of 1e-9 rad or m. The fixtures'
    places are unknown: they start where the middle of the joint limits puts the tip. Where links
    have masses, those of side branches count as they are with their joints at 0, and gravity
    points down the z axis of the root.

    Raises:
        RigError: not a URDF, no such link, or a chain that a rig cannot describe.
    """
    doubts = doubts or Doubts()
    if constraint not in CONSTRAINTS:
        raise RigError(
            f"the constraint is '{constraint}', expected one of: {', '.join(CONSTRAINTS)}"
        )
    robot = parsed(text)
    links = chain_to(robot, tip)
    lines = [
        f"# The chain to {tip} of the URDF of {robot.name}; written by loopcal rig from-urdf.",
        "schema = 1",
        f'name = "{robot.name}"',
        "",
    ]
    if any(link.mass for link in links):
        lines += [
            "# Of a base that stands upright.",
            f"gravity_m_per_s2 = [0.0, 0.0, {-GRAVITY!r}]",
            "",
        ]
    lines += ["[mechanism]", 'family = "serial"', f'closure = {{ constraint = "{constraint}" }}']
    if gravity_compensated:
        lines.append('standing = "gravity-compensated"')
    channels: list[str] = []
    reached = previous = _NONE
    for number, (link, frame) in enumerate(zip(links, _frames(links), strict=True), 1):
        transform = previous.T @ link.transform @ frame
        at = pose_of(transform)
        reached, previous = reached @ transform, frame
        if link.joint is None:
            if link.name is not None or not np.array_equal(transform, _NONE):
                known = link.name is None or not doubts.tip
                lines += ["", "[mechanism.tip]", *_pose_lines(at, doubts, known=known)]
            continue
        joint, axis = link.joint, frame[:3, :3].T @ axis_of(link.joint) + 0.0
        home, kind = home_of(joint), MOVING[joint.type]
        unit = "rad" if kind == "revolute" else "m"
        lines += ["", "[[mechanism.joint]]", f'name = "{joint.name}"', f'type = "{kind}"']
        if frame is not _NONE:
            lines.append("# This frame is the URDF's with its axes permuted: ry was a right angle.")
        lines += [
            'convention = "urdf"',
            f"axis = {[float(a) for a in axis]}",
            f"home_{unit} = {home!r}",
        ]
        if joint.limit is not None and joint.type != "continuous":
            lines.append(
                f"limits_{unit} = [{float(joint.limit.lower)!r}, {float(joint.limit.upper)!r}]"
            )
        lines += _pose_lines(at, doubts, known=False)
        if link.mass:
            com = frame[:3, :3].T @ np.array(link.com) + 0.0
            lines += [f"mass_kg = {link.mass!r}", f"com_m = {[float(c) for c in com]}"]
        channels += ["", "[[channel]]", f'name = "q{number}"', f'senses = "{joint.name}"']
        channels += [
            f"gain_{unit}_per_count = {COUNT!r}",
            f"noise_counts = {doubts.noise_rad / COUNT!r}",
        ]
        if doubts.encoder_rad > 0:
            channels.append(f"offset_{unit} = {_uncertain(0.0, doubts.encoder_rad)}")
        reached = reached @ moved(axis, home, kind)
    freed = CONSTRAINTS[constraint]
    if "rz" in freed and np.hypot(reached[0, 0], reached[1, 0]) < _STEEP:
        # Its own turn about z is anybody's: one that keeps ry from the right angle.
        reached[:3, :3] = with_level_x(reached[:3, :3])
    seek = sought(reached[:3, :3], freed)
    for name in fixtures:
        lines += ["", "[[mechanism.fixture]]", f'name = "{name}"']
        for part, value in zip(POSE, pose_of(reached), strict=True):
            unit = "m" if part in "xyz" else "rad"
            wanted = f"{{ nominal = {value!r}, identify = true }}"
            lines.append(f"{part}_{unit} = {wanted if part in seek else repr(value)}")
    toml = "\n".join([*lines, *channels]) + "\n"
    parse_rig(toml, f"the rig of robot '{robot.name}'")
    return toml


def calibrated_urdf(text: str, tip: str, values: Mapping[str, float]) -> str:
    """A URDF whose origins are those of a calibrated rig; all else stays as it was.

    Args:
        text: the URDF that the rig was made from.
        tip: the link that it was made for.
        values: parameters by name, SI, as `rig_from_urdf` names them. Offsets of q1, q2, ... become
            part of the origins; nothing else of a channel can be said in a URDF.

    Raises:
        RigError: not a URDF, no such link, or a parameter of the chain is missing.
    """
    document = etree.fromstring(text.encode("utf-8"))
    elements = {element.get("name"): element for element in document.findall("joint")}
    links = chain_to(parsed(text), tip)
    previous = _NONE
    for number, (link, frame) in enumerate(zip(links, _frames(links), strict=True), 1):
        ahead, previous = previous, frame
        if link.name is None:
            continue
        owner = link.name if link.joint is not None else "tip"
        try:
            estimate = transform_of(*(values[f"{owner}.{part}"] for part in POSE))
            offset = values.get(f"q{number}.offset", 0.0)
        except KeyError as error:
            raise RigError(
                f"the values have no parameter {error}; they are not of a rig made from this URDF"
            ) from error
        estimate = ahead @ estimate @ frame.T
        if link.joint is not None:
            estimate = estimate @ moved(axis_of(link.joint), offset, MOVING[link.joint.type])
        pose = pose_of(np.linalg.inv(link.before) @ estimate)
        element = elements[link.name]
        origin = element.find("origin")
        if origin is None:
            origin = etree.SubElement(element, "origin")
        origin.set("xyz", " ".join(repr(value) for value in pose[:3]))
        origin.set("rpy", " ".join(repr(value) for value in pose[3:]))
    # The serializer would run what stands ahead of the root element together.
    prolog = re.split(r"<robot[\s>]", text, maxsplit=1)[0]
    return prolog + str(etree.tostring(document, encoding="unicode")) + "\n"


def _frames(links: Sequence[Link]) -> list[Array]:
    """For each link a rotation (4, 4): how the rig's frame behind it is turned against the URDF's.

    No ry of a joint, of the tip or of a fixture where the tip is at home is then near a right
    angle. Only one of a frame's axes can be upright, so that one of three permutations will do.
    The tip may turn only about its own z, which is the same for every constraint.
    """
    end = _NONE
    for link in links:
        end = end @ link.transform
        if link.joint is not None:
            joint = link.joint
            end = end @ moved(axis_of(joint), home_of(joint), MOVING[joint.type])
    last = _ASIDE if _is_steep(end) else _NONE
    tip = links[-1]
    out: list[Array] = []
    previous = _NONE
    for link in links[:-1]:
        options = [_NONE, _CYCLED, _CYCLED.T]
        behind = None
        if link is links[-2]:
            if tip.name is None:
                options = [last, *options]  # without a tip none has to be made
            else:
                behind = tip.transform @ last
        previous = next(
            frame
            for frame in options
            if not _is_steep(previous.T @ link.transform @ frame)
            and (behind is None or not _is_steep(frame.T @ behind))
        )
        out.append(previous)
    return [*out, last]


def _is_steep(transform: Array) -> bool:
    """Whether ry of a transform (4, 4) is near a right angle: its x axis is upright."""
    return bool(np.hypot(transform[0, 0], transform[1, 0]) < _STEEP)


def _uncertain(value: float, width: float) -> str:
    return f"{{ nominal = {value!r}, uncertainty = {width!r}, identify = true }}"


def _pose_lines(at: tuple[float, ...], doubts: Doubts, *, known: bool) -> list[str]:
    out = []
    for part, value in zip(POSE, at, strict=True):
        length = part in "xyz"
        width = doubts.length_m if length else doubts.angle_rad
        held = known or not width > 0
        text = repr(value) if held else _uncertain(value, width)
        out.append(f"{part}_{'m' if length else 'rad'} = {text}")
    return out
