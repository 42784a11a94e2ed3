"""What gravity asks of a closed chain that stands still: torques of its drives, force on its fixture.

Virtual work. Where the joints give way by dq, gravity works Q dq, the drives tau dq, and the
closure, which allows no dq with C dq = 0 to fail, lambda C dq; at rest

    Q + E tau + C* lambda = 0,

one row a joint, where E picks the driven ones: free joints and hinges carry no torque. With as
many drives as the loop has freedoms this has one solution; with more, that of least squares is
taken, as of drives that share alike. The wrench w at the fixture is the one that does the same
work as lambda: C* lambda = G* w, where G dq is the twist of the chain's end.

An arm that compensates its own weight needs neither: each drive exerts tau_j = -Q_j, and nothing
rests on the fixture.

With S_j the first moment and M_j the mass of what joint j moves against the base, a revolute
joint has Q_j = axis_j . (S_j - M_j o_j) x g, a prismatic one M_j axis_j . g.

What leans on joint j about its origin is (S_j - M_j o_j) x g of the weights, and of the fixture's push
on the end its moment about o_j; across the axis the joint's bearing carries it.

Owns loads only: what gives way under them are effects (`sim_devices.plant.effects`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recordings.rig import Rig, SerialMechanism
from sim_devices.plant.chain import Chain, ChainGeometry, Fixed, transforms_ahead
from sim_devices.plant.quaternion import Array, cross, product, turn

_REGULAR = 1e-13
"""Share of its trace added to a normal matrix, so that redundant rows do no harm."""


@dataclass(frozen=True, slots=True)
class ChainLoads:
    """Loads of n configurations.

    Attributes:
        torque: (n, J) that each drive exerts on the link behind it [Nm, or N of a slide].
        force: (n, 3) that the end of the chain exerts on the fixture [N], in the fixture's axes.
        moment: (n, 3) likewise, about the fixture's origin [Nm].
        leaning: (n, J, 3) moment of all that acts behind each joint, about the joint's origin, in the
            axes of the frame before it turns [Nm]; what the bearing holds across the joint's axis, z.
    """

    torque: Array
    force: Array
    moment: Array
    leaning: Array

    def seen_from(self, frame: Fixed | None) -> tuple[Array, Array]:
        """Force and moment (n, 3) in the axes of ``frame`` (n, ...) and about its origin; None changes nothing."""
        if frame is None:
            return self.force, self.moment
        back = frame.back.turn
        about_origin = self.moment - cross(frame.shift, self.force)
        return turn(back, self.force), turn(back, about_origin)


def has_weights(rig: Rig) -> bool:
    """Whether a chain of joints has what loads are computed from."""
    mechanism = rig.mechanism
    return (
        isinstance(mechanism, SerialMechanism)
        and rig.gravity is not None
        and (_compensated(mechanism) or (rig.plan is not None and bool(rig.plan.drives)))
        and any(joint.mass for joint in mechanism.joints)
    )


def _compensated(mechanism: SerialMechanism) -> bool:
    return mechanism.standing == "gravity-compensated"


class ChainStatics:
    """Loads of a chain of joints.

    Args:
        mechanism: with masses.
        values: parameters, SI, by name.
        gravity: (3,) in the base frame [m/s^2].
        drives: joints that hold; the others are free. Under gravity compensation all hold.
    """

    def __init__(
        self,
        mechanism: SerialMechanism,
        values: Mapping[str, float],
        gravity: Array,
        drives: tuple[str, ...],
    ) -> None:
        joints = mechanism.joints
        names = mechanism.places
        self._chain = Chain(mechanism)
        self._revolute = np.array([joint.type == "revolute" for joint in joints])
        self._compensated = _compensated(mechanism)
        self._held = [names.index(drive) for drive in drives]
        self._base = 0 if mechanism.base is None else names.index(mechanism.base) + 1
        self._gravity = gravity
        ahead = transforms_ahead(mechanism, values)
        self._from_base = ahead[self._base].back.turn
        self._mass = np.array([joint.mass or 0.0 for joint in joints])
        # Centres in the frame that the chain reaches behind each link: that before the next joint.
        centres = [np.array(joint.com or (0.0, 0.0, 0.0)) for joint in joints]
        back = [transform.back for transform in ahead[1:]]
        self._com = np.array(
            [turn(b.turn, c) + b.shift for b, c in zip(back, centres, strict=True)]
        )

    def loads(self, geometry: ChainGeometry, variables: Array) -> ChainLoads:
        """Loads at closed configurations ``variables`` (n, J)."""
        turns, frames, origins = self._chain.reach(geometry, variables)
        axis, at = frames[:, :-1, 2], origins[:, :-1]
        gravity = turn(product(turns[:, self._base], self._from_base), self._gravity)
        centre = turn(turns[:, 1:], self._com) + origins[:, 1:]
        mass, moment = self._moved(centre)
        lever = moment - mass[:, None] * at
        of_turn = np.sum(axis * cross(lever, gravity[:, None]), axis=2)
        of_slide = mass * np.sum(axis * gravity[:, None], axis=2)
        work = np.where(self._revolute, of_turn, of_slide)
        weight = cross(lever, gravity[:, None])
        if self._compensated:
            nothing = np.zeros((len(work), 3))
            return ChainLoads(-work, nothing, nothing, _in_frames(frames, weight))

        _, rate = self._chain.closure_of(turns, frames, origins)
        held = np.eye(variables.shape[1])[self._held]
        rows = np.concatenate([np.broadcast_to(held, (len(rate), *held.shape)), rate], axis=1)
        borne = _least_squares(rows, -work)
        torque = np.zeros_like(work)
        torque[:, self._held] = borne[:, : len(held)]

        by_closure = (rate.transpose(0, 2, 1) @ borne[:, len(held) :, None])[:, :, 0]
        turning = axis * self._revolute[:, None]
        twist = np.concatenate([cross(at, turning) + axis * ~self._revolute[:, None], turning], 2)
        wrench = _least_squares(twist.transpose(0, 2, 1), by_closure)
        pushed = wrench[:, None, 3:] - cross(at, np.broadcast_to(wrench[:, None, :3], at.shape))
        leaning = _in_frames(frames, weight + pushed)
        return ChainLoads(torque, -wrench[:, :3], -wrench[:, 3:], leaning)

    def _moved(self, centre: Array) -> tuple[Array, Array]:
        """Mass (J,) that each joint moves against the base, and its first moment (n, J, 3), signed.

        Links behind the base are moved by the joints ahead of them; links between the start and
        the base by the joints behind them, backwards.
        """
        mass, moment = self._mass, self._mass[:, None] * centre
        behind = np.arange(len(mass)) >= self._base
        mass_behind = np.cumsum((mass * behind)[::-1])[::-1]
        moment_behind = np.cumsum((moment * behind[:, None])[:, ::-1], axis=1)[:, ::-1]
        mass_before = np.cumsum(mass) - mass
        moment_before = np.cumsum(moment, axis=1) - moment
        return (
            np.where(behind, mass_behind, -mass_before),
            np.where(behind[:, None], moment_behind, -moment_before),
        )


def _in_frames(frames: Array, moment: Array) -> Array:
    """Moments (n, J, 3) in the axes of the frames before each joint."""
    return np.asarray((frames[:, :-1] @ moment[..., None])[..., 0])


def _least_squares(rows: Array, wanted: Array) -> Array:
    """x (n, r) for which rows* x comes nearest to ``wanted`` (n, J); ``rows`` is (n, r, J)."""
    normal = rows @ rows.transpose(0, 2, 1)
    trace = np.trace(normal, axis1=1, axis2=2)
    normal += (_REGULAR * trace + 1e-300)[:, None, None] * np.eye(rows.shape[1])
    return np.asarray(np.linalg.solve(normal, rows @ wanted[:, :, None])[:, :, 0])
