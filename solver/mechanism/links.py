"""The elementary motions of joints, tips and fixtures, in each convention that a rig may use.

Owns the translation of `recordings.rig` joints into `Motion`s: Denavit-Hartenberg, Hayati, and
URDF's origins and axes. Knows no loop and no sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from recordings.rig import POSE, Joint
from solver.mechanism.chain import Motion
from solver.mechanism.model import TILTS


def joint_motions(joint: Joint, index: Mapping[str, int], coordinate: int) -> list[Motion]:
    """The motions of ``joint``, whose variable is ``coordinate``; parameters by ``index`` of their names.

    Where ``index`` has the joint's tilts, it can tilt across its axis before it turns.
    """
    turning = joint.type == "revolute"
    part = {name: index[f"{joint.name}.{name}"] for name in joint.parts}
    if joint.convention == "urdf":
        return [*pose_motions(joint.name, index), *_about(joint, index, coordinate)]
    if joint.convention == "hayati":
        return [
            *_tilts(joint, index, 2),
            Motion("turn", 2, part["theta_offset"], coordinate),
            Motion("shift", 0, part["a"]),
            Motion("turn", 0, part["alpha"]),
            Motion("turn", 1, part["beta"]),
        ]
    return [
        *_tilts(joint, index, 2),
        Motion("turn", 2, part["theta_offset"], coordinate if turning else -1),
        Motion("shift", 2, part["s"], -1 if turning else coordinate),
        Motion("shift", 0, part["a"]),
        Motion("turn", 0, part["alpha"]),
    ]


def pose_motions(name: str, index: Mapping[str, int]) -> list[Motion]:
    """A fixed transform with the parameters ``<name>.<x|y|z|rx|ry|rz>``."""
    x, y, z, rx, ry, rz = (index[f"{name}.{part}"] for part in POSE)
    shifts = [Motion("shift", axis, parameter) for axis, parameter in enumerate((x, y, z))]
    return [*shifts, Motion("turn", 2, rz), Motion("turn", 1, ry), Motion("turn", 0, rx)]


def inverse(motions: list[Motion]) -> list[Motion]:
    """Motions that undo ``motions``."""
    return [
        Motion(m.kind, m.axis, m.parameter, m.coordinate, -m.constant, -m.sign)
        for m in reversed(motions)
    ]


def _tilts(joint: Joint, index: Mapping[str, int], axis: int) -> list[Motion]:
    """The tilts of a joint that turns about ``axis``."""
    names = [f"{joint.name}.{tilt}" for tilt in TILTS]
    return [
        Motion("turn", (axis + k) % 3, index[name])
        for k, name in enumerate(names, 1)
        if name in index
    ]


def _about(joint: Joint, index: Mapping[str, int], coordinate: int) -> list[Motion]:
    """The joint's own motion. About a skew axis: z turned onto it, the motion, z turned back."""
    kind: Literal["turn", "shift"] = "turn" if joint.type == "revolute" else "shift"
    axis = np.array(joint.direction)
    along = np.flatnonzero(axis == 1.0)
    if len(along):
        own = int(along[0])
        return [*_tilts(joint, index, own), Motion(kind, own, coordinate=coordinate)]
    azimuth = float(np.arctan2(axis[1], axis[0]))
    inclination = float(np.arctan2(np.hypot(axis[0], axis[1]), axis[2]))
    onto = [
        Motion("turn", 2, constant=azimuth),
        Motion("turn", 1, constant=inclination),
    ]
    moved = Motion(kind, 2, coordinate=coordinate)
    return [*onto, *_tilts(joint, index, 2), moved, *inverse(onto)]
