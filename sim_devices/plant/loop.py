"""Configurations that close the loop: correcting, following and finding them.

Newton's method on the closure error. Where the joints in motion are more than the loop
determines, each correction is the one of least motion (minimum norm), so that joints that
nothing drives do not drift. Steps along a path are taken only while Newton's corrections
contract (Deuflhard's test); otherwise they are halved, down to the point where the
mechanism blocks.

Owns no time and no drives: `held` says which joints something outside holds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.rig import SerialMechanism
from sim_devices.plant.chain import Chain, ChainGeometry, Fixed
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.errors import MechanismDoesNotClose
from sim_devices.plant.quaternion import Array

CLOSED = 1e-11
"""Largest closure error of a closed loop [m, rad]."""
_NEAR = 1e-5
"""The same at the knots of a path, which are polished later."""
_REGULAR = 1e-13
"""Share of its trace added to a normal matrix, so that redundant closure rows do no harm."""
_PIECE = np.deg2rad(8.0)
"""Longest step of the held joints along a path [rad, m]."""
_REACH = 0.35
"""Longest correction that a step may need before it is halved [rad, m]."""
_LEVER = 30.0
"""Where others would move more than this many times as far as the held joints, near a singular
configuration, friction jams the mechanism [rad, m a rad, m]."""
_SLACK = 1e-3
"""A correction of this size is always taken: the geometry itself may move [rad, m]."""
_SMALLEST = 1.0 / 256
"""Share of the longest step below which the mechanism is taken to block."""
_INDEPENDENT = 1e-4
"""A joint leads while its motion, others held, is at least this share of the freedoms left."""
_STARTS = 300


class Loop:
    """The closed loop of a serial mechanism.

    Args:
        mechanism: joints, limits and closure.
        geometry: as it really is, at rest and without effects.
        effects: all effects at work.
    """

    def __init__(
        self, mechanism: SerialMechanism, geometry: ChainGeometry, effects: Sequence[Effect] = ()
    ) -> None:
        self._chain = Chain(mechanism)
        names = [joint.name for joint in mechanism.joints]
        self._base = 0 if mechanism.base is None else names.index(mechanism.base) + 1
        self._geometry = geometry
        self._effects = effects
        joints = mechanism.joints
        self._revolute = np.array([joint.type == "revolute" for joint in joints])
        self._low = np.array([j.limits.low if j.limits else -np.inf for j in joints])
        self._high = np.array([j.limits.high if j.limits else np.inf for j in joints])
        self._home = np.array([joint.home.nominal for joint in joints])
        # A home that the rig states has the dimension of its key.
        self._home_is_known = any(joint.home.dimension for joint in joints)

    def closure(self, variables: Array, time_s: Array) -> tuple[Array, Array]:
        """Closure error (n, m) and its rate (n, m, J) at joint variables (n, J) and times (n,)."""
        return self._chain.closure(self.geometry(variables, time_s), variables)

    def geometry(self, variables: Array, time_s: Array) -> ChainGeometry:
        """The geometry at joint variables (n, J) and times (n,), with what effects make of it."""
        geometry = self._geometry
        for effect in self._effects:
            geometry = effect.geometry(geometry, time_s, variables)
        return geometry

    def end(self, variables: Array, time_s: Array) -> tuple[Array, Array]:
        """Turns (n, 4) and origins (n, 3) [m] of the chain's end, in the base frame."""
        geometry = self.geometry(variables, time_s)
        turns, _, origins = self._chain.reach(geometry, variables)
        base = Fixed(turns[:, self._base], origins[:, self._base])
        if geometry.ahead is not None:
            ahead = geometry.ahead
            base = base.then(Fixed(ahead.turn[self._base], ahead.shift[..., self._base, :]).back)
        end = base.back.then(Fixed(turns[:, -1], origins[:, -1]))
        return end.turn, end.shift

    @property
    def is_steady(self) -> bool:
        """Whether the geometry is the same at all times."""
        return not any(effect.moves_geometry_in_time for effect in self._effects)

    def within_limits(self, variables: Array) -> NDArray[np.bool_]:
        """Whether all joints (..., J) are within their limits, shape (...)."""
        within = (variables >= self._low) & (variables <= self._high)
        return np.asarray(np.all(within, axis=-1))

    def clipped(self, joint: int, variable: float) -> float:
        """``variable`` of a joint, brought within its limits."""
        return float(np.clip(variable, self._low[joint], self._high[joint]))

    def leaders(self, variables: Array, time_s: float, drives: Sequence[int]) -> list[int]:
        """Those of ``drives`` that the loop lets move, each with the ones before it held.

        A drive that is left out can only follow the others: the mechanism has no freedom for it.
        """
        _, rate = self.closure(variables[None], np.array([time_s]))
        _, size, right = np.linalg.svd(rate[0])
        rank = int(np.sum(size > 1e-9 * max(size[0], 1e-300))) if len(size) else 0
        freedoms = right[rank:].T
        chosen: list[int] = []
        for drive in drives:
            moves = freedoms[drive]
            if chosen:
                basis = np.linalg.qr(freedoms[chosen].T)[0]
                moves = moves - basis @ (basis.T @ moves)
            if np.linalg.norm(moves) > _INDEPENDENT:
                chosen.append(drive)
        return chosen

    def polish(
        self, variables: Array, held: NDArray[np.bool_], time_s: Array
    ) -> tuple[Array, Array]:
        """Close n loops that are nearly closed.

        Args:
            variables: (n, J) start.
            held: (J,) joints that stay.
            time_s: (n,).

        Returns:
            (n, J) variables; (n,) closure errors that remain.
        """
        out = variables.copy()
        left = np.full(len(out), np.inf)
        active = np.arange(len(out))
        for _ in range(12):
            asked, geometry = active, self.geometry(out[active], time_s[active])
            error, rate = self._chain.closure(geometry, out[active])
            left[active] = np.abs(error).max(axis=1, initial=0.0)
            open_ = left[active] > CLOSED
            active = active[open_]
            if not len(active):
                break
            motion = _least_motion(error[open_], rate[open_][:, :, ~held])
            out[np.ix_(active, ~held)] += motion
            if self._effects:
                # Loads cost more than a correction: a second one before they are asked again.
                error, rate = self._chain.closure(geometry, out[asked])
                out[np.ix_(asked, ~held)] += _least_motion(error, rate[:, :, ~held])
        return out, left

    def follow(
        self, variables: Array, held: Sequence[int], target: Array, time_s: float
    ) -> tuple[Array, Array]:
        """Move the held joints straight to ``target``, the others as the loop demands.

        Args:
            variables: (J,) closed configuration to start from.
            held: joints that something drives.
            target: (len(held),) where they are to go.
            time_s: when.

        Returns:
            (k, J) configurations passed, the start first; (k,) shares of the way at which they
            lie, the last below 1 where the mechanism blocks.
        """
        is_held = np.zeros(len(variables), dtype=bool)
        is_held[list(held)] = True
        start = variables[list(held)]
        way = float(np.linalg.norm(target - start))
        longest = 1.0 / max(1.0, np.ceil(way / _PIECE))
        passed, shares, size = [variables], [0.0], longest
        # What yields under load is not asked again on the way: the knots are polished later.
        geometry = self.geometry(variables[None], np.array([time_s]))
        while shares[-1] < 1.0:
            share = min(1.0, shares[-1] + size)
            trial = passed[-1].copy()
            trial[list(held)] = start + share * (target - start)
            reach = min(_REACH, 2 * _LEVER * way * (share - shares[-1]) + _SLACK)
            solved = self._corrected(trial, is_held, geometry, reach)
            if solved is not None and self.within_limits(solved):
                passed.append(solved)
                shares.append(share)
                size = min(2 * size, longest)
            elif size > _SMALLEST * longest:
                size /= 2
            else:
                break
        return np.array(passed), np.array(shares)

    def _corrected(
        self, trial: Array, held: NDArray[np.bool_], geometry: ChainGeometry, reach: float
    ) -> Array | None:
        """``trial`` (J,) brought to closure; None when that is too far, does not contract, or jams."""
        here = trial[None].copy()
        allowed = reach
        for _ in range(8):
            error, rate = self._chain.closure(geometry, here)
            if np.abs(error).max(initial=0.0) < _NEAR:
                jams = held.any() and _lever(rate[0], held) > _LEVER
                return None if jams else np.asarray(here[0])
            motion = _least_motion(error, rate[:, :, ~held])
            size = float(np.linalg.norm(motion))
            if size > allowed:
                return None
            here[:, ~held] += motion
            allowed = 0.5 * size
        return None

    def assemble(self, rng: np.random.Generator) -> Array:
        """A closed configuration within limits (J,): that of the joints' homes, or near to them.

        Where the rig states no homes, or the loop does not close from them, the nearest of
        many seeded starts is taken.

        Raises:
            MechanismDoesNotClose: no start leads to closure within limits.
        """
        if self._home_is_known:
            at_home, closed = self._closed_from(self._home[None])
            if closed[0]:
                return np.asarray(at_home[0])
        spread = np.where(self._revolute, np.pi, 0.5)
        low = np.maximum(self._low, self._home - spread)
        high = np.minimum(self._high, self._home + spread)
        starts = rng.uniform(np.minimum(low, high), np.maximum(low, high), (_STARTS, len(low)))
        found, closed = self._closed_from(starts)
        if not closed.any():
            raise MechanismDoesNotClose(
                f"the loop does not close: {_STARTS} starts within the joint limits left at least "
                f"{self._least_error(found):.3g} (m or rad) open; check the link lengths and angles, the "
                f"joint limits and the closure of the mechanism"
            )
        away = np.linalg.norm(found - self._home, axis=1)
        return np.asarray(found[np.argmin(np.where(closed, away, np.inf))])

    def _closed_from(self, starts: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Where bounded Newton steps lead from ``starts`` (n, J), and which of them close."""
        here, now = starts.copy(), np.zeros(len(starts))
        for _ in range(80):
            error, rate = self.closure(here, now)
            if np.abs(error).max(initial=0.0) < CLOSED:
                break
            damping = np.minimum(np.sum(error**2, axis=1), 1.0) * 1e-3
            motion = _least_motion(error, rate, damping)
            size = np.linalg.norm(motion, axis=1, keepdims=True)
            here += motion * np.minimum(1.0, 0.3 / np.maximum(size, 1e-12))
        turned = self._home + (here - self._home + np.pi) % (2 * np.pi) - np.pi
        here = np.where(self._revolute, turned, here)
        here, left = self.polish(here, np.zeros(here.shape[1], dtype=bool), now)
        return here, (left <= CLOSED) & self.within_limits(here)

    def _least_error(self, variables: Array) -> float:
        error, _ = self.closure(variables, np.zeros(len(variables)))
        return float(np.abs(error).max(axis=1).min())


def _least_motion(error: Array, rate: Array, damping: Array | float = 0.0) -> Array:
    """Smallest motion (n, k) that undoes ``error`` (n, m) to first order; ``rate`` is (n, m, k)."""
    rows = error.shape[1]
    if rows == 0:
        return np.zeros((len(error), rate.shape[2]))
    normal = rate @ rate.transpose(0, 2, 1)
    trace = np.trace(normal, axis1=1, axis2=2)
    normal += ((_REGULAR * trace + 1e-300 + damping)[:, None, None]) * np.eye(rows)
    weights = np.linalg.solve(normal, error[:, :, None])
    return np.asarray(-(rate.transpose(0, 2, 1) @ weights)[:, :, 0])


def _lever(rate: Array, held: NDArray[np.bool_]) -> float:
    """How far the free joints move for a unit motion of the held ones; ``rate`` is (m, J)."""
    rows, free = len(rate), rate[:, ~held]
    normal = free @ free.T
    normal += (_REGULAR * np.trace(normal) + 1e-300) * np.eye(rows)
    return float(np.linalg.norm(free.T @ np.linalg.solve(normal, rate[:, held])))
