"""A chain of elementary motions, its end transform, and the screw axis of every motion.

Denavit-Hartenberg links, Hayati links, URDF joints, tools and fixtures are all products of
rotations and translations along one axis of a moving frame. A `Chain` is the list of them.
The derivative of the end transform with respect to any motion is then that motion's screw:

    rotation about unit axis w through point q:   dp = w x (p - q),  domega = w
    translation along w:                          dp = w,            domega = 0

(all in the start frame), which is all that an analytic Jacobian needs. Owns kinematics
only: it knows no sensors, no noise, no parameters by name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motion:
    """One elementary motion: along or about axis x, y or z of the frame reached so far.

    Its size is the sum of what it names: a constant, and ``sign`` times a parameter or a joint
    coordinate.

    Attributes:
        kind: "turn" [rad] or "shift" [m].
        axis: 0, 1 or 2 for x, y, z.
        parameter: index into the parameter vector, or -1.
        coordinate: index into the pose's coordinates, or -1.
        constant: fixed part of the size.
        sign: -1 where it undoes what it names.
    """

    kind: Literal["turn", "shift"]
    axis: int
    parameter: int = -1
    coordinate: int = -1
    constant: float = 0.0
    sign: float = 1.0


@dataclass(frozen=True, slots=True)
class Reached:
    """Where a chain ends, and the screws of its motions.

    Attributes:
        rotation: (P, 3, 3), start frame from end frame.
        position: (P, 3) [m], end origin in the start frame.
        screws: (P, 6, M), column m is the rate of [dp; domega] with motion m (of those asked
            for), start frame.
    """

    rotation: Array
    position: Array
    screws: Array


@dataclass(frozen=True, slots=True)
class Chain:
    """Elementary motions in order from the start frame to the end frame."""

    motions: tuple[Motion, ...]

    def reach(
        self, coordinates: Array, parameters: Array, wanted: NDArray[np.intp] | None = None
    ) -> Reached:
        """End transform and screws for many poses at once.

        Args:
            coordinates: (P, U) [rad or m], each pose's joint coordinates.
            parameters: (N,) [rad or m], or (P, N) where some differ from pose to pose.
            wanted: motions whose screws are needed, ascending; all of them by default.
        """
        poses = len(coordinates)
        asked = range(len(self.motions)) if wanted is None else wanted.tolist()
        place = {m: i for i, m in enumerate(asked)}
        # Poses run along the last axis: every operation below is on contiguous (3, P) arrays.
        # Columns of the rotation are kept apart: a turn about one mixes the other two.
        columns = [np.repeat(unit[:, None], poses, axis=1) for unit in np.eye(3)]
        position = np.zeros((3, poses))
        sizes = np.ascontiguousarray(coordinates.T)
        if parameters.ndim == 2 and not poses:
            parameters = np.zeros(parameters.shape[1])
        first = parameters if parameters.ndim == 1 else parameters[0]
        varying = set(
            np.flatnonzero((parameters != first).any(axis=0)) if first is not parameters else ()
        )
        axes = np.empty((len(place), 3, poses))
        origins = np.empty((len(place), 3, poses))
        for m, motion in enumerate(self.motions):
            axis = columns[motion.axis]
            if m in place:
                axes[place[m]], origins[place[m]] = axis, position
            fixed: float | Array = motion.constant
            if motion.parameter in varying:
                fixed = fixed + motion.sign * parameters[:, motion.parameter]
            elif motion.parameter >= 0:
                fixed += motion.sign * float(first[motion.parameter])
            same = isinstance(fixed, float)
            if motion.coordinate < 0 and same and fixed == 0.0:
                continue
            if motion.kind == "shift":
                size = (
                    fixed
                    if motion.coordinate < 0
                    else fixed + motion.sign * sizes[motion.coordinate]
                )
                position = position + axis * size
            else:
                second, third = (motion.axis + 1) % 3, (motion.axis + 2) % 3
                cos: float | Array
                sin: float | Array
                if motion.coordinate < 0 and isinstance(fixed, float):
                    cos, sin = math.cos(fixed), math.sin(fixed)
                else:
                    angle = (
                        fixed
                        if motion.coordinate < 0
                        else fixed + motion.sign * sizes[motion.coordinate]
                    )
                    cos, sin = np.cos(angle), np.sin(angle)
                columns[second], columns[third] = (
                    columns[second] * cos + columns[third] * sin,
                    columns[third] * cos - columns[second] * sin,
                )
        screws = np.zeros((poses, 6, len(place)))
        turning = np.array([self.motions[m].kind == "turn" for m in asked], dtype=bool)
        linear, angular = axes.copy(), axes
        linear[turning] = cross(axes[turning], position - origins[turning])
        angular[~turning] = 0.0
        screws[:, :3] = linear.transpose(2, 1, 0)
        screws[:, 3:] = angular.transpose(2, 1, 0)
        rotation = np.ascontiguousarray(np.array(columns).transpose(2, 1, 0))
        return Reached(rotation, np.ascontiguousarray(position.T), screws)


def cross(left: Array, right: Array) -> Array:
    """Cross product along axis 1 of two (M, 3, P) arrays."""
    out = np.empty(np.broadcast_shapes(left.shape, right.shape))
    out[:, 0] = left[:, 1] * right[:, 2] - left[:, 2] * right[:, 1]
    out[:, 1] = left[:, 2] * right[:, 0] - left[:, 0] * right[:, 2]
    out[:, 2] = left[:, 0] * right[:, 1] - left[:, 1] * right[:, 0]
    return out
