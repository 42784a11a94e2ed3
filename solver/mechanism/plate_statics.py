"""What the legs of a plate at rest carry, and its pivot.

Tensions T of the legs with dV/du + (dL/du)' T = 0, where V(u) is the plate's potential energy and L
are the legs' lengths; where there are more legs than freedoms equal legs share, which is the
solution of least norm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recordings.rig import PlatformMechanism, Rig, parameters
from solver.mechanism.loads import Loads
from solver.mechanism.platform import PlatformModel
from solver.mechanism.rotation import left_jacobian

Array = NDArray[np.float64]

_RANK = 1e-8  # of the largest singular value
_BALANCED = 1e-6  # of the largest generalised weight


def plate_loads(rig: Rig, mechanism: PlatformMechanism, coordinates: Array, values: Array) -> Loads:
    """Tensions of the legs, and the force on the pivot, of a plate that stands on them."""
    assert rig.gravity is not None
    assert mechanism.plate_com is not None
    plain = rig.model_copy(update={"effects": ()})
    table = parameters(plain)
    index = {p.name: i for i, p in enumerate(table)}
    model = PlatformModel.of(
        plain.model_copy(
            update={
                "trackers": (),
                "channels": tuple(c for c in plain.channels if c.senses in mechanism.places),
            }
        ),
        table,
    )

    def points(names: list[str]) -> Array:
        return np.array([[values[index[f"{name}.{axis}"]] for axis in "xyz"] for name in names])

    rotation, position = model.plate_pose(coordinates)
    turned = np.swapaxes(rotation, 1, 2)
    arm = points([leg.plate for leg in mechanism.legs]) @ turned  # (P, L, 3)
    way = position[:, None] + arm - points([leg.base for leg in mechanism.legs])
    along = way / np.linalg.norm(way, axis=2, keepdims=True)
    weight = (mechanism.plate_mass or 0.0) * np.array(rig.gravity)
    tip = np.array(mechanism.plate_com) @ turned
    by_u, pulled = [], []
    if model.turns:
        jacobian = left_jacobian(coordinates[:, :3])
        pulled.append(np.cross(arm, along) @ jacobian)
        by_u.append((-np.cross(tip, weight)[:, None] @ jacobian)[:, 0])
    if model.shifts:
        pulled.append(along)
        by_u.append(np.broadcast_to(-weight, position.shape))
    rising = np.concatenate(by_u, axis=1)
    lengthening = np.swapaxes(np.concatenate(pulled, axis=2), 1, 2)  # (P, U, L)
    tension = -(np.linalg.pinv(lengthening, rcond=_RANK) @ rising[:, :, None])[:, :, 0]
    balance = rising + (lengthening @ tension[:, :, None])[:, :, 0]
    if np.abs(balance).max() > _BALANCED * float(np.abs(rising).max()):
        return Loads(None, None, why="the legs do not carry the plate at every pose: it would fall")
    if mechanism.plate != "pivoted":
        return Loads(tension, None, why="the plate has no pivot")
    return Loads(tension, weight - np.sum(tension[:, :, None] * along, axis=1))
