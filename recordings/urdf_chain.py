"""The chain between two links of a URDF: its joints, what is fixed between them, what hangs on them.

Owns what of a URDF a calibration needs. Refuses floating and planar joints, joints that mimic
others, and numbers that are none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from urdf_parser_py import urdf
from urdf_parser_py.xml_reflection import core as reflection

from recordings.errors import RigError

Array = NDArray[np.float64]

MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
"""What a rig calls the types of joint that move."""

_LOCKED = 1e-6  # |cos ry| below which turns about x and z are the same


@dataclass(frozen=True, slots=True)
class Link:
    """A moving joint with all that is fixed between it and the moving joint before it.

    Attributes:
        joint: of the URDF; None for what is behind the last moving joint.
        before: (4, 4), product of the fixed joints ahead of it.
        origin: (4, 4), of the joint, or of the last fixed one behind the last moving joint.
        name: of the joint whose origin that is; None where there is none.
        mass: of what the joint moves, up to the next moving joint of the chain [kg].
        com: (3,) its centre, in the frame behind the joint [m].
    """

    joint: urdf.Joint | None
    before: Array
    origin: Array
    name: str | None
    mass: float = 0.0
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def transform(self) -> Array:
        """(4, 4), from the frame of the moving joint before it."""
        return np.asarray(self.before @ self.origin)


def parsed(text: str) -> urdf.URDF:
    """The document; raises RigError where it is not a URDF."""
    try:
        robot = urdf.URDF.from_xml_string(text.encode("utf-8"))
    except (
        SyntaxError, reflection.ParseError, AssertionError, AttributeError, TypeError, ValueError
    ) as error:  # fmt: skip
        # The parser takes what it expects for granted: a text where there is none, and the like.
        raise RigError(f"not a URDF: {error}") from error
    return robot


def chain_to(robot: urdf.URDF, tip: str) -> list[Link]:
    """The moving joints from the root to ``tip``, then what is fixed behind the last of them."""
    if tip not in robot.link_map:
        raise RigError(f"the URDF has no link '{tip}'; it has: {', '.join(sorted(robot.link_map))}")
    names: list[str] = []
    link = tip
    while link in robot.parent_map:
        name, link = robot.parent_map[link]
        if name in names:
            raise RigError(f"the links above '{tip}' form a loop through the joint '{name}'")
        names.append(name)
    out: list[Link] = []
    before, last, owner = np.eye(4), np.eye(4), None
    for name in reversed(names):
        joint = robot.joint_map[name]
        before = before @ last
        last, owner = origin_of(joint), name
        if joint.type in MOVING:
            if joint.mimic is not None:
                raise RigError(
                    f"joint '{name}' mimics '{joint.mimic.joint}', which no rig describes"
                )
            mass, com = _moved_by(robot, joint.child, names)
            out.append(Link(joint, before, last, name, mass, com))
            before, last, owner = np.eye(4), np.eye(4), None
        elif joint.type != "fixed":
            raise RigError(
                f"joint '{name}' is of type {joint.type}, expected fixed, revolute, continuous or prismatic"
            )
    if not out:
        raise RigError(f"no joint moves between the root of the URDF and the link '{tip}'")
    return [*out, Link(None, before, last, owner)]


def _moved_by(
    robot: urdf.URDF, link: str, chain: Sequence[str]
) -> tuple[float, tuple[float, float, float]]:
    """Mass [kg] of a link and of what hangs on it, and its centre in the link's frame [m].

    Moving joints of the ``chain`` are not passed: what is behind them is moved by them.
    """
    mass, moment = 0.0, np.zeros(3)
    todo = [(link, np.eye(4))]
    seen = {link}
    with np.errstate(over="ignore", invalid="ignore"):
        while todo:
            name, frame = todo.pop()
            own, centre = _weighed(robot.link_map.get(name))
            mass += own
            moment += own * (frame[:3, :3] @ centre + frame[:3, 3])
            for joint_name, child in robot.child_map.get(name, ()):
                joint = robot.joint_map[joint_name]
                if child not in seen and not (joint_name in chain and joint.type in MOVING):
                    seen.add(child)
                    todo.append((child, frame @ origin_of(joint)))
        x, y, z = (float(part) for part in (moment / mass if mass > 0.0 else moment))
    if not 0.0 <= mass < np.inf or not np.isfinite([x, y, z]).all():
        raise RigError(
            f"link '{link}' and what hangs on it weigh {mass:g} kg, with the centre at {x:g}, {y:g}, "
            f"{z:g} m; expected a mass of 0 or above and finite numbers"
        )
    return mass, (x, y, z)


def _weighed(link: urdf.Link | None) -> tuple[float, Array]:
    """Mass of a link [kg], and its centre (3,) in the frame of the link [m]; 0 where none is given."""
    if link is None or link.inertial is None:
        return 0.0, np.zeros(3)
    mass, origin = float(link.inertial.mass), link.inertial.origin
    if mass < 0.0:
        raise RigError(f"link '{link.name}' has the mass {mass:g} kg, expected 0 or above")
    return mass, np.array((origin and origin.xyz) or (0.0, 0.0, 0.0), np.float64)


def origin_of(joint: urdf.Joint) -> Array:
    """(4, 4), frame of the joint in that of the link before it."""
    if joint.origin is None:
        return np.eye(4)
    x, y, z = joint.origin.xyz or (0.0, 0.0, 0.0)
    rx, ry, rz = joint.origin.rpy or (0.0, 0.0, 0.0)
    if not np.isfinite([x, y, z, rx, ry, rz]).all():
        raise RigError(f"joint '{joint.name}' has an origin that is not of finite numbers")
    return transform_of(x, y, z, rx, ry, rz)


def axis_of(joint: urdf.Joint) -> Array:
    """(3,) unit vector that the joint turns about or slides along."""
    axis = np.array(joint.axis if joint.axis is not None else (1.0, 0.0, 0.0), dtype=np.float64)
    largest = float(np.abs(axis).max())
    if not 0 < largest < np.inf:
        raise RigError(
            f"joint '{joint.name}' has an axis of length {largest:g}, expected a direction"
        )
    axis = axis / largest
    return np.asarray(axis / np.linalg.norm(axis))


def home_of(joint: urdf.Joint) -> float:
    """The middle of the limits, where it has any."""
    if joint.limit is None or joint.type == "continuous":
        return 0.0
    home = 0.5 * float(joint.limit.lower) + 0.5 * float(joint.limit.upper)
    if not np.isfinite(home):
        raise RigError(f"joint '{joint.name}' has limits that are not finite numbers")
    return home


def moved(axis: Array, size: float, kind: str) -> Array:
    """(4, 4), a turn about or a slide along ``axis`` (3,) by ``size``; Rodrigues' formula."""
    out = np.eye(4)
    if kind == "prismatic":
        out[:3, 3] = axis * size
        return out
    x, y, z = axis
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out[:3, :3] += np.sin(size) * hat + (1.0 - np.cos(size)) * (hat @ hat)
    return out


def transform_of(x: float, y: float, z: float, rx: float, ry: float, rz: float) -> Array:
    """(4, 4), Tx Ty Tz Rz Ry Rx."""
    turns = [moved(unit, a, "revolute") for unit, a in zip(np.eye(3), (rx, ry, rz), strict=True)]
    out = turns[2] @ turns[1] @ turns[0]
    out[:3, 3] = x, y, z
    return np.asarray(out)


def pose_of(transform: Array) -> tuple[float, ...]:
    """x, y, z, rx, ry, rz of a transform (4, 4)."""
    turn = transform[:3, :3]
    level = float(np.hypot(turn[0, 0], turn[1, 0]))
    ry = float(np.arctan2(-turn[2, 0], level))
    if level > _LOCKED:
        rx, rz = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    else:
        rx, rz = np.arctan2(-turn[1, 2], turn[1, 1]), 0.0
    # Adding 0 turns -0.0 into 0.0, which reads better in a file.
    return tuple(float(value) + 0.0 for value in (*transform[:3, 3], rx, ry, rz))
