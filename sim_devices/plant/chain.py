"""A closed chain of joints as it really is: where it ends, how far it is from closing.

Each joint turns and shifts the frame reached so far, as in Giugovaz & Hollerbach, Figure 1:
Rz(theta) Tz(s) Tx(a) Rx(alpha). The two turns of one joint are one unit quaternion

    f = (cos t cos u, cos t sin u, sin t sin u, sin t cos u),   t = theta/2, u = alpha/2,

and its shift, seen before the turns, is d = (a cos theta, a sin theta, s). Running products
of the f are the frames, running sums of the turned d their origins. Joints described otherwise
(Hayati's, URDF's), a tip and a fixture become such joints with fixed transforms between them.

Owns geometry only: no time, no sensors, no drives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from recordings.rig import POSE, Joint, SerialMechanism
from sim_devices.plant.quaternion import (
    IDENTITY,
    Array,
    about,
    axes,
    cross,
    product,
    running_product,
    turn,
)


@dataclass(frozen=True, slots=True)
class Fixed:
    """Fixed transforms: turn (..., 4) and shift (..., 3) [m] of the frame behind seen from the one ahead."""

    turn: Array
    shift: Array

    def then(self, other: Fixed) -> Fixed:
        """This one, and ``other`` behind it."""
        return Fixed(product(self.turn, other.turn), self.shift + turn(self.turn, other.shift))

    @property
    def back(self) -> Fixed:
        """The way back."""
        undone = self.turn * _CONJUGATE
        return Fixed(undone, -turn(undone, self.shift))


_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
_NOTHING = Fixed(IDENTITY, np.zeros(3))
_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class ChainGeometry:
    """Lengths and angles of a chain of J joints; arrays (J,), or (n, J) where they vary by sample.

    Attributes:
        theta_offset, alpha: [rad].
        s, a: [m].
        fixture_turn: (4,) or (n, 4), turn of the start frame against where the chain should end.
        fixture_shift: (3,) or (n, 3) [m], its shift.
        seat: fixed transform from the frame where the chain should end to its first joint, or None
            where there is nothing between.
        links: fixed transforms behind each joint, likewise.
        first_reach: (3,) [m] share of the seat's shift that belongs to the first joint's origin.
        ahead: fixed transforms (J + 1) ahead of each joint and of the tip, which the frames that
            joints begin in lie behind; None where they are nothing.
    """

    theta_offset: Array
    s: Array
    a: Array
    alpha: Array
    fixture_turn: Array
    fixture_shift: Array
    seat: Fixed | None = None
    links: Fixed | None = None
    first_reach: Array | None = None
    ahead: Fixed | None = None


def displaced(geometry: ChainGeometry, turned: Array, shifted: Array) -> ChainGeometry:
    """``geometry`` with the frame where the chain should end displaced, in itself.

    Args:
        geometry: of a chain.
        turned: (n, 4) turn.
        shifted: (n, 3) [m].
    """
    start = Fixed(turned, shifted).back.then(Fixed(geometry.fixture_turn, geometry.fixture_shift))
    return replace(geometry, fixture_turn=start.turn, fixture_shift=start.shift)


def transforms_ahead(mechanism: SerialMechanism, values: Mapping[str, float]) -> list[Fixed]:
    """Fixed transforms ahead of each joint, and that of the tip: J + 1."""
    ahead = [_ahead(joint, values) for joint in mechanism.joints]
    ahead.append(_NOTHING if mechanism.tip is None else _placed("tip", values))
    return ahead


def chain_geometry(
    mechanism: SerialMechanism, values: Mapping[str, float], fixture: str | None = None
) -> ChainGeometry:
    """Geometry out of parameter values [rad, m] by name, of a chain that ends in ``fixture``."""
    joints = mechanism.joints
    columns = {
        part: np.array([values.get(f"{joint.name}.{part}", 0.0) for joint in joints])
        for part in ("theta_offset", "s", "a", "alpha")
    }
    bare = ChainGeometry(
        columns["theta_offset"],
        columns["s"],
        columns["a"],
        columns["alpha"],
        fixture_turn=IDENTITY,
        fixture_shift=np.zeros(3),
    )
    plain = all(joint.convention == "dh" for joint in joints)
    if plain and mechanism.tip is None and fixture is None:
        return bare
    ahead = transforms_ahead(mechanism, values)
    behind = [_behind(joint, values) for joint in joints]
    links = [behind[j].then(ahead[j + 1]) for j in range(len(joints))]
    stand = _NOTHING if fixture is None else _placed(fixture, values).back
    return replace(
        bare,
        seat=stand.then(ahead[0]),
        links=Fixed(np.array([k.turn for k in links]), np.array([k.shift for k in links])),
        first_reach=turn(stand.turn, ahead[0].shift),
        ahead=Fixed(np.array([k.turn for k in ahead]), np.array([k.shift for k in ahead])),
    )


def _placed(name: str, values: Mapping[str, float]) -> Fixed:
    """URDF's origin: xyz, then turned about the fixed x, y and z axes."""
    return pose([values[f"{name}.{part}"] for part in POSE])


def pose(parts: Sequence[float]) -> Fixed:
    """x, y, z [m], then turned by rx, ry, rz [rad] about the fixed x, y and z axes."""
    x, y, z, roll, pitch, yaw = parts
    turned = product(
        about(_Z, np.array(yaw)), product(about(_Y, np.array(pitch)), about(_X, np.array(roll)))
    )
    return Fixed(turned, np.array([x, y, z]))


def _onto(joint: Joint) -> Array:
    """Turn (4,) that brings z onto the axis of ``joint``, about the line across both."""
    x, y, z = joint.direction
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    half = np.array([1.0 + z, -y, x, 0.0])
    return np.asarray(half / np.linalg.norm(half))


def _ahead(joint: Joint, values: Mapping[str, float]) -> Fixed:
    if joint.convention != "urdf":
        return _NOTHING
    return _placed(joint.name, values).then(Fixed(_onto(joint), np.zeros(3)))


def _behind(joint: Joint, values: Mapping[str, float]) -> Fixed:
    if joint.convention == "urdf":
        return Fixed(_onto(joint), np.zeros(3)).back
    if joint.convention == "hayati":
        return Fixed(about(_Y, np.array(values[f"{joint.name}.beta"])), np.zeros(3))
    return _NOTHING


class Chain:
    """Closure error of a chain and its rate, for n configurations at once.

    An endpoint freedom lets the end frame shift along its own axes or turn about them; two
    free turns are a universal joint, x before y before z. In a fixture free shifts are along the
    fixture's axes instead, and the universal joint begins at the fixture.

    Args:
        mechanism: joints and closure.
    """

    def __init__(self, mechanism: SerialMechanism) -> None:
        self._turns_joint = np.array([float(j.type == "revolute") for j in mechanism.joints])
        self._slides_joint = 1.0 - self._turns_joint
        free = mechanism.closure.freedoms
        self._shifts = [k for k, name in enumerate(("x", "y", "z")) if name not in free]
        self._turns = [k for k, name in enumerate(("rx", "ry", "rz")) if name not in free]
        self._turn_rows = len(self._turns)
        self._in_fixture = bool(mechanism.fixtures)

    def reach(self, geometry: ChainGeometry, variables: Array) -> tuple[Array, Array, Array]:
        """Frames along the chain.

        Args:
            geometry: of this chain.
            variables: (n, J) joint variables [rad or m].

        Returns:
            (n, J + 1, 4) turns of the frames before each joint, and of the end; (n, J + 1, 3, 3)
            their axes, one a row; (n, J + 1, 3) their origins [m]; all in the start frame.
        """
        theta = geometry.theta_offset + variables * self._turns_joint
        slide = geometry.s + variables * self._slides_joint
        half, twist = theta / 2, geometry.alpha / 2
        ct, st, cu, su = np.cos(half), np.sin(half), np.cos(twist), np.sin(twist)
        factors = np.empty((*theta.shape, 4))
        for k, (one, other) in enumerate(((ct, cu), (ct, su), (st, su), (st, cu))):
            np.multiply(one, other, out=factors[..., k])
        start = Fixed(geometry.fixture_turn, geometry.fixture_shift)
        if geometry.seat is not None:
            start = start.then(geometry.seat)
        frames_of_joints = factors
        if geometry.links is not None:
            factors = product(factors, np.broadcast_to(geometry.links.turn, factors.shape))
        turns = running_product(start.turn, factors)
        frames = axes(turns)
        shift = np.empty((*theta.shape, 3))
        np.multiply(geometry.a, np.cos(theta), out=shift[..., 0])
        np.multiply(geometry.a, np.sin(theta), out=shift[..., 1])
        shift[..., 2] = slide
        if geometry.links is not None:
            shift += turn(frames_of_joints, geometry.links.shift)
        origins = np.empty((len(theta), theta.shape[1] + 1, 3))
        origins[:, 0] = start.shift
        origins[:, 1:] = (shift[:, :, None, :] @ frames[:, :-1])[:, :, 0]
        np.cumsum(origins, axis=1, out=origins)
        return turns, frames, origins

    def closure(self, geometry: ChainGeometry, variables: Array) -> tuple[Array, Array]:
        """How far the loop is from closing.

        Args:
            geometry: of this chain.
            variables: (n, J) joint variables [rad or m].

        Returns:
            (n, m) closure error [m for shifts, rad for turns when small]; (n, m, J) its rate.
        """
        return self.closure_of(*self.reach(geometry, variables))

    def closure_of(self, turns: Array, frames: Array, origins: Array) -> tuple[Array, Array]:
        """`closure` of frames as `reach` gives them."""
        axis, end = frames[:, :-1, 2], frames[:, -1]
        turning = axis * self._turns_joint[:, None]
        error = np.empty((len(end), len(self._shifts) + self._turn_rows))
        rate = np.empty((*error.shape, axis.shape[1]))
        shifts = len(self._shifts)
        if shifts:
            # Seen from the end frame, whose own axes the free shifts follow, the start is at
            # r = end* origin, and joint j moves it by end* (point_j x axis_j), or end* axis_j.
            # In a fixture the end itself is looked at: joint j moves it by axis_j x (end - point_j).
            arm = origins[:, -1:] - origins[:, :-1] if self._in_fixture else -origins[:, :-1]
            swung = cross(turning, arm) + axis * self._slides_joint[:, None]
            kept = np.eye(3)[None, self._shifts] if self._in_fixture else end[:, self._shifts]
            error[:, :shifts] = (kept @ origins[:, -1, :, None])[:, :, 0]
            rate[:, :shifts] = kept @ swung.transpose(0, 2, 1)
        if self._turn_rows >= 2:
            # d(2 u)/dt = w omega + omega x u for the vector part u of the end's turn.
            last = turns[:, -1] * np.where(turns[:, -1, :1] < 0, -1.0, 1.0)
            spin = last[:, None, :1] * turning + cross(turning, last[:, None, 1:])
            error[:, shifts:] = 2 * last[:, 1:][:, self._turns]
            rate[:, shifts:] = spin[:, :, self._turns].transpose(0, 2, 1)
        elif self._turn_rows == 1:
            # A universal joint keeps its two axes at right angles.
            first, second = (k for k in range(3) if k not in self._turns)
            if self._in_fixture:
                first, second = second, first
            error[:, shifts] = end[:, first, second]
            rate[:, shifts] = cross(turning, end[:, None, first])[:, :, second]
        return error, rate
