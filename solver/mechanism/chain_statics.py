"""What a chain of joints at rest carries: torques of its drives, moments on its bearings, force on its fixture.

Virtual work. Of a chain that closes, C(u, m) = 0 with m a displacement of its fixture, and whose
links have the potential energy V(u, m),

    dV/du_f + C_f' lambda = 0          for the coordinates f that nothing holds,
    tau_j   = dV/du_j + C_j' lambda    what the drive of joint j exerts on its link,
    moment  = dV/dt + C_t' lambda      what holds a joint against tilts t across its axis,
    force   = -(dV/dm + C_m' lambda)   what the mechanism exerts on its fixture.

With enough free joints the first row determines lambda: loads then follow from masses alone. Where
it does not, drives could brace themselves against each other, and nobody knows by how much: no
load is given. Of an arm under gravity compensation lambda = 0: every joint carries what it moves,
and the fixture bears nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, SerialMechanism, parameters
from solver.mechanism.chain import Chain, Motion
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.links import joint_motions
from solver.mechanism.loads import Loads
from solver.mechanism.model import TILTS, imperfections, mechanism_model

Array = NDArray[np.float64]

_RANK = 1e-8  # of the largest singular value
_BALANCED = 1e-6  # of the largest generalised weight
_NOTHING = 1e-10  # likewise: less is rounding


@dataclass(frozen=True, slots=True)
class _Chain:
    """A chain with its imperfections, at P poses.

    Attributes:
        rig: without effects.
        values: (N + I,) parameters, and zeros for the imperfections.
        index: of every one of them, by name.
        tilts: (J, 2) which of them are the tilts of each joint; -1 of a slide.
        coordinates: (P, U).
    """

    rig: Rig
    mechanism: SerialMechanism
    values: Array
    index: Mapping[str, int]
    tilts: NDArray[np.intp]
    coordinates: Array

    @classmethod
    def of(cls, rig: Rig, mechanism: SerialMechanism, coordinates: Array, values: Array) -> _Chain:
        plain = rig.model_copy(update={"effects": ()})
        named = [p.name for p in parameters(plain)]
        names = (*named, *imperfections(plain))
        index = {name: i for i, name in enumerate(names)}
        x = np.concatenate([values[: len(named)], np.zeros(len(names) - len(named))])
        tilts = [[index.get(f"{place}.{t}", -1) for t in TILTS] for place in mechanism.places]
        return cls(plain, mechanism, x, index, np.array(tilts, dtype=np.intp), coordinates)


def compensated_loads(
    rig: Rig, mechanism: SerialMechanism, coordinates: Array, values: Array
) -> Loads:
    """Loads of a chain each of whose joints carries the weight of what it moves."""
    weight = _weight(_Chain.of(rig, mechanism, coordinates, values))
    torque = weight.by_coordinates[:, : len(mechanism.joints)]
    slack = [k for k, place in enumerate(mechanism.places) if rig.sensed_by(place) is None]
    if np.abs(torque[:, slack]).max(initial=0.0) > _BALANCED * float(np.abs(torque).max()):
        names = ", ".join(mechanism.places[k] for k in slack)
        return Loads(
            None,
            None,
            why=f"weight rests on joints without a sensor ({names}), which have no drive to compensate it",
        )
    # An upright joint carries nothing, and no rounding either: effects would take it for a load.
    least = _NOTHING * float(np.abs(torque).max(initial=0.0))
    torque, moment = (
        np.where(np.abs(load) > least, load, 0.0) for load in (torque, weight.by_tilts)
    )
    return Loads(torque, np.zeros((len(coordinates), 3)), moment)


def driven_loads(
    rig: Rig,
    mechanism: SerialMechanism,
    coordinates: Array,
    values: Array,
    held: NDArray[np.bool_],
    at: Circumstances | None,
) -> Loads:
    """Loads of a chain whose joints ``held`` (J,) are held by drives."""
    chain = _Chain.of(rig, mechanism, coordinates, values)
    turning = chain.tilts[:, 0] >= 0
    moved = [chain.index[f"mount.{axis}"] for axis in "xyz"] + chain.tilts[turning].ravel().tolist()
    directions = np.zeros((len(chain.values), len(moved)))
    directions[moved, np.arange(len(moved))] = 1.0
    model = mechanism_model(chain.rig, parameters(chain.rig), imperfect=True)
    closed = model.linearise(coordinates, chain.values, directions, at)
    weight = _weight(chain)
    joints = len(mechanism.joints)
    driven = np.zeros(coordinates.shape[1], dtype=bool)
    driven[:joints] = held
    by_u = np.swapaxes(closed.closure_by_coordinates, 1, 2)
    by_moved = np.swapaxes(closed.closure_by_parameters, 1, 2)
    free = by_u[:, ~driven]
    inverse = np.linalg.pinv(free, rcond=_RANK)
    multiplier = -(inverse @ weight.by_coordinates[:, ~driven, None])
    borne = weight.by_coordinates + (by_u @ multiplier)[:, :, 0]
    most = float(np.abs(weight.by_coordinates).max())
    if np.abs(borne[:, ~driven]).max(initial=0.0) > _BALANCED * most:
        names = ", ".join(j.name for j, h in zip(mechanism.joints, held, strict=True) if h)
        return Loads(
            None,
            None,
            why=f"the held joints ({names or 'none'}) do not carry the mechanism: it would fall",
        )
    left = np.eye(by_u.shape[2]) - inverse @ free  # (P, K, K) multipliers that nothing free feels
    if np.abs(by_u[:, driven] @ left).max(initial=0.0) > _BALANCED:
        return Loads(
            None,
            None,
            why="more joints were held than the mechanism has freedoms, so that their drives may brace "
            "each other: let all but as many joints go free as it has freedoms",
        )
    torque = np.where(driven, borne, 0.0)[:, :joints]
    if np.abs(by_moved @ left).max(initial=0.0) > _BALANCED:
        return Loads(
            torque,
            None,
            why="the mechanism may be braced within its fixture, so that the force on it is not known",
        )
    reaction = (by_moved @ multiplier)[:, :, 0]
    moment = weight.by_tilts
    moment[:, turning] += reaction[:, 3:].reshape(len(moment), -1, len(TILTS))
    return Loads(torque, -(weight.by_mount + reaction[:, :3]), moment)


@dataclass(frozen=True, slots=True)
class _Weight:
    """How the links' potential energy V changes.

    Attributes:
        by_coordinates: (P, U) [Nm or N].
        by_mount: (3,) with the mount, in the base frame [N].
        by_tilts: (P, J, 2) [Nm].
    """

    by_coordinates: Array
    by_mount: Array
    by_tilts: Array


def _weight(chain: _Chain) -> _Weight:
    """The links' weights.

    Gravity is that of the base frame. Links between the start of the chain and the base are moved
    by the joints between them and the base, backwards; and with the mount, where the base frame has
    no fixture and the mount stands before it.
    """
    mechanism, coordinates, values = chain.mechanism, chain.coordinates, chain.values
    assert chain.rig.gravity is not None
    gravity = np.array(chain.rig.gravity)
    motions: list[Motion] = []
    ends = []
    for u, joint in enumerate(mechanism.joints):
        motions += joint_motions(joint, chain.index, u)
        ends.append(len(motions))
    names = mechanism.places
    behind = -1 if mechanism.base is None else names.index(mechanism.base)
    base = ends[behind] if behind >= 0 else 0
    by_u = np.zeros(coordinates.shape)
    by_mount = np.zeros(3)
    by_value = np.zeros((len(coordinates), len(values)))
    for i, joint in enumerate(mechanism.joints):
        if not joint.mass or joint.com is None:
            continue
        com = np.array(joint.com)
        part = slice(min(base, ends[i]), max(base, ends[i]))
        between = motions[part]
        reached = Chain(tuple(between)).reach(coordinates, values)
        ahead = (
            i > behind
        )  # the chain leads from the base to the link, else from the link to the base
        arm = reached.rotation @ com if ahead else com - reached.position
        linear, angular = np.moveaxis(reached.screws[:, :3], 1, 2), reached.screws[:, 3:]
        rates = linear + np.cross(np.moveaxis(angular, 1, 2), arm[:, None])  # (P, M, 3)
        if not ahead:  # seen from the link its centre rests and the base moves
            rates = -rates @ reached.rotation
            if not mechanism.fixtures:
                by_mount -= joint.mass * gravity
        rising = -joint.mass * rates @ gravity
        for m, motion in enumerate(between):
            if motion.coordinate >= 0:
                by_u[:, motion.coordinate] += motion.sign * rising[:, m]
            if motion.parameter >= 0:
                by_value[:, motion.parameter] += motion.sign * rising[:, m]
    by_tilts = np.where(chain.tilts >= 0, by_value[:, chain.tilts], 0.0)
    return _Weight(by_u, by_mount, by_tilts)
