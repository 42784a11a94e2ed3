"""A closed chain of joints as it really is: where it ends, how far it is from closing.

Each joint turns and shifts the frame reached so far, as in Giugovaz & Hollerbach, Figure 1:
Rz(theta) Tz(s) Tx(a) Rx(alpha). The two turns of one joint are one unit quaternion

    f = (cos t cos u, cos t sin u, sin t sin u, sin t cos u),   t = theta/2, u = alpha/2,

and its shift, seen before the turns, is d = (a cos theta, a sin theta, s). Running products
of the f are the frames, running sums of the turned d their origins.

Owns geometry only: no time, no sensors, no drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recordings.rig import SerialMechanism
from sim_devices.plant.quaternion import IDENTITY, Array, axes, cross, running_product


@dataclass(frozen=True, slots=True)
class ChainGeometry:
    """Lengths and angles of a chain of J joints; arrays (J,), or (n, J) where they vary by sample.

    Attributes:
        theta_offset, alpha: [rad].
        s, a: [m].
        fixture_turn: (4,) or (n, 4), turn of the start frame against where the chain should end.
        fixture_shift: (3,) or (n, 3) [m], its shift.
    """

    theta_offset: Array
    s: Array
    a: Array
    alpha: Array
    fixture_turn: Array
    fixture_shift: Array


def chain_geometry(mechanism: SerialMechanism, values: Mapping[str, float]) -> ChainGeometry:
    """Geometry out of parameter values [rad, m] by name."""
    columns = {
        part: np.array([values[f"{joint.name}.{part}"] for joint in mechanism.joints])
        for part in ("theta_offset", "s", "a", "alpha")
    }
    return ChainGeometry(**columns, fixture_turn=IDENTITY, fixture_shift=np.zeros(3))


class Chain:
    """Closure error of a chain and its rate, for n configurations at once.

    An endpoint freedom lets the end frame shift along its own axes or turn about them; two
    free turns are a universal joint, x before y before z.

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
        turns = running_product(geometry.fixture_turn, factors)
        frames = axes(turns)
        shift = np.empty((*theta.shape, 3))
        np.multiply(geometry.a, np.cos(theta), out=shift[..., 0])
        np.multiply(geometry.a, np.sin(theta), out=shift[..., 1])
        shift[..., 2] = slide
        origins = np.empty((len(theta), theta.shape[1] + 1, 3))
        origins[:, 0] = geometry.fixture_shift
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
        turns, frames, origins = self.reach(geometry, variables)
        axis, end = frames[:, :-1, 2], frames[:, -1]
        turning = axis * self._turns_joint[:, None]
        error = np.empty((len(end), len(self._shifts) + self._turn_rows))
        rate = np.empty((*error.shape, axis.shape[1]))
        shifts = len(self._shifts)
        if shifts:
            # Seen from the end frame, whose own axes the free shifts follow, the start is at
            # r = end* origin, and joint j moves it by end* (point_j x axis_j), or end* axis_j.
            swung = cross(origins[:, :-1], turning) + axis * self._slides_joint[:, None]
            kept = end[:, self._shifts]
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
            error[:, shifts] = end[:, first, second]
            rate[:, shifts] = cross(turning, end[:, None, first])[:, :, second]
        return error, rate
