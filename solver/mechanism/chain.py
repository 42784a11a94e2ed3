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

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motion:
    """One elementary motion: along or about axis x, y or z of the frame reached so far.

    Its size is the sum of what it names: a parameter, a joint coordinate, or a constant.

    Attributes:
        kind: "turn" [rad] or "shift" [m].
        axis: 0, 1 or 2 for x, y, z.
        parameter: index into the parameter vector, or -1.
        coordinate: index into the pose's coordinates, or -1.
        constant: fixed part of the size.
    """

    kind: Literal["turn", "shift"]
    axis: int
    parameter: int = -1
    coordinate: int = -1
    constant: float = 0.0


@dataclass(frozen=True, slots=True)
class Reached:
    """Where a chain ends, and the screws of its motions.

    Attributes:
        rotation: (P, 3, 3), start frame from end frame.
        position: (P, 3) [m], end origin in the start frame.
        screws: (P, 6, M), column m is the rate of [dp; domega] with motion m, start frame.
    """

    rotation: Array
    position: Array
    screws: Array


@dataclass(frozen=True, slots=True)
class Chain:
    """Elementary motions in order from the start frame to the end frame."""

    motions: tuple[Motion, ...]

    def reach(self, coordinates: Array, parameters: Array) -> Reached:
        """End transform and screws for many poses at once.

        Args:
            coordinates: (P, U) [rad or m], each pose's joint coordinates.
            parameters: (N,) [rad or m].
        """
        poses = len(coordinates)
        # Columns of the rotation are kept apart, each (P, 3): a turn about one mixes the other two.
        columns = [np.tile(unit, (poses, 1)) for unit in np.eye(3)]
        position = np.zeros((poses, 3))
        axes, origins = [], []
        for motion in self.motions:
            size: Array | np.float64 = np.float64(motion.constant)
            if motion.parameter >= 0:
                size = size + parameters[motion.parameter]
            if motion.coordinate >= 0:
                size = size + coordinates[:, motion.coordinate, None]
            axis = columns[motion.axis]
            axes.append(axis)
            origins.append(position)
            if motion.coordinate < 0 and size == 0.0:
                continue
            if motion.kind == "shift":
                position = position + axis * size
            else:
                second, third = (motion.axis + 1) % 3, (motion.axis + 2) % 3
                cos, sin = np.cos(size), np.sin(size)
                columns[second], columns[third] = (
                    columns[second] * cos + columns[third] * sin,
                    columns[third] * cos - columns[second] * sin,
                )
        direction = np.stack(axes, axis=2)
        screws = np.zeros((poses, 6, len(self.motions)))
        turns = np.array([motion.kind == "turn" for motion in self.motions])
        shifts = ~turns
        screws[:, :3, shifts] = direction[:, :, shifts]
        if turns.any():
            arm = position[:, :, None] - np.stack(origins, axis=2)[:, :, turns]
            screws[:, :3, turns] = cross(direction[:, :, turns], arm)
            screws[:, 3:, turns] = direction[:, :, turns]
        return Reached(np.stack(columns, axis=2), position, screws)


def cross(left: Array, right: Array) -> Array:
    """Cross product along axis 1 of two (P, 3, M) arrays."""
    out = np.empty(np.broadcast_shapes(left.shape, right.shape))
    out[:, 0] = left[:, 1] * right[:, 2] - left[:, 2] * right[:, 1]
    out[:, 1] = left[:, 2] * right[:, 0] - left[:, 0] * right[:, 2]
    out[:, 2] = left[:, 0] * right[:, 1] - left[:, 1] * right[:, 0]
    return out
