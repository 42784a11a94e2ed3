"""The hand that moves a plate by a script: irregular as people are, yet seeded.

It visits random turns within the plan's tilt and swivel about the neutral pose, moves
with minimum jerk, rests a little longer than asked, and comes back to a pose only nearly.
At rest the plate does not move: it is set down, not held in the air.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recordings.rig import Plan, Visit
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.motion import minimum_jerk
from sim_devices.plant.plate import Plate
from sim_devices.plant.quaternion import Array, about, angle_between, between, product
from sim_devices.plant.seeds import HAND, stream
from sim_devices.plant.stop import Stop

_DEFAULT_TURN = np.deg2rad(20.0)
"""Tilt and swivel where the plan says none [rad]."""
_SHIFT = 0.15
"""A plate that shifts is moved up to this share of its mean leg length from neutral."""
_REPEAT_RAD = np.deg2rad(0.5)
_REPEAT_SHIFT = 0.005
"""How nearly a person comes back: standard deviation of turns [rad], of shifts [mean leg length]."""
_MARGIN = 0.02
"""Legs stay this share of their sensor's span inside its ends."""
_PEAK = 1.875
"""Peak speed of a minimum-jerk move over its mean speed."""
_SHORTEST_MOVE_S = 0.4


class Hand:
    """A scripted hand; its rounds through the poses follow each other without end.

    Args:
        plan: tilt, swivel, speed and dwell.
        visits: stops of one round.
        plate: what it moves.
        spans: for each leg, readings [m] that its sensor can show, None without limits.
        seed: of nature.

    Raises:
        CannotSimulate: no pose within tilt and swivel keeps the legs within their sensors.
    """

    def __init__(
        self,
        plan: Plan,
        visits: Sequence[Visit],
        plate: Plate,
        spans: Sequence[tuple[float, float] | None],
        seed: int,
    ) -> None:
        self._plan, self._visits, self._plate, self._seed = plan, visits, plate, seed
        neutral = (plate.neutral_turn[None], plate.neutral_shift[None])
        self._size = float(plate.lengths(*neutral, np.zeros(1)).mean())
        self._turns, self._shifts = self._poses(
            spans, 1 + max((v.pose for v in visits), default=-1)
        )
        # Way points of all rounds so far: times at which the plate leaves and arrives, and its poses.
        self._moves: list[tuple[float, float]] = []
        self._way_turns = [plate.neutral_turn]
        self._way_shifts = [plate.neutral_shift]

    def _poses(
        self, spans: Sequence[tuple[float, float] | None], count: int
    ) -> tuple[Array, Array]:
        """(count, 4) turns and (count, 3) shifts, ordered so that moves are short."""
        plan, plate = self._plan, self._plate
        rng = stream(self._seed, HAND)
        low = np.array([-np.inf if s is None else s[0] + _MARGIN * (s[1] - s[0]) for s in spans])
        high = np.array([np.inf if s is None else s[1] - _MARGIN * (s[1] - s[0]) for s in spans])
        turns, shifts = np.empty((0, 4)), np.empty((0, 3))
        for _ in range(50):
            n = 4 * count
            way = rng.uniform(-np.pi, np.pi, n)
            level = np.stack([np.cos(way), np.sin(way), np.zeros(n)], axis=1)
            tilt = (_DEFAULT_TURN if plan.tilt is None else plan.tilt) * np.sqrt(
                rng.uniform(size=n)
            )
            swivel = (_DEFAULT_TURN if plan.swivel is None else plan.swivel) * rng.uniform(-1, 1, n)
            up = np.broadcast_to([0.0, 0.0, 1.0], (n, 3))
            turn = product(product(about(level, tilt), about(up, swivel)), plate.neutral_turn)
            ball = rng.standard_normal((n, 3))
            ball *= np.cbrt(rng.uniform(size=(n, 1))) / np.linalg.norm(ball, axis=1, keepdims=True)
            shift = plate.neutral_shift + _SHIFT * self._size * ball * plate.shifts
            if not plate.turns:
                turn = np.broadcast_to(plate.neutral_turn, (n, 4))
            legs = plate.readings(turn, shift, np.zeros(n))
            good = np.all((legs >= low) & (legs <= high), axis=1)
            turns, shifts = np.vstack([turns, turn[good]]), np.vstack([shifts, shift[good]])
            if len(turns) >= count:
                order = self._short_path(turns[:count], shifts[:count])
                return turns[order], shifts[order]
        raise CannotSimulate(
            f"only {len(turns)} of {200 * count} poses within the plan's tilt and swivel about the "
            f"neutral pose keep every leg within the range of its sensor; lower tilt and swivel, or "
            f"check 'neutral', the points, the offsets and the count ranges"
        )

    def _apart(self, turns: Array, shifts: Array, turn: Array, shift: Array) -> Array:
        """How far a move is: the angle [rad], or the shift [m] where that is more."""
        shifted = np.linalg.norm(shifts - shift, axis=-1)
        return np.asarray(np.maximum(angle_between(turns, turn), shifted))

    def _short_path(self, turns: Array, shifts: Array) -> list[int]:
        """Each pose followed by the nearest not yet visited, from neutral on."""
        left, path = list(range(len(turns))), []
        turn, shift = self._plate.neutral_turn, self._plate.neutral_shift
        while left:
            path.append(
                left.pop(int(np.argmin(self._apart(turns[left], shifts[left], turn, shift))))
            )
            turn, shift = turns[path[-1]], shifts[path[-1]]
        return path

    def round(self, number: int, start_s: float) -> tuple[Stop, ...]:
        """Go through all visits once more, from ``start_s`` on; rounds are asked for in order.

        Args:
            number: 0 for the first round; later rounds come back to each pose only nearly.
            start_s: when the first move begins.
        """
        plan = self._plan
        rng = stream(self._seed, HAND, 1 + number)
        stops = []
        for visit in self._visits:
            again = float(visit.visit > 0 or number > 0)
            wobble = rng.standard_normal((2, 3)) * again
            angle = float(np.linalg.norm(wobble[0])) * _REPEAT_RAD * self._plate.turns
            axis = wobble[0] / max(float(np.linalg.norm(wobble[0])), 1e-12)
            turn = product(about(axis, np.array(angle)), self._turns[visit.pose])
            shift = (
                self._shifts[visit.pose]
                + _REPEAT_SHIFT * self._size * wobble[1] * self._plate.shifts
            )
            way = float(self._apart(turn, shift, self._way_turns[-1], self._way_shifts[-1]))
            quick = max(_PEAK * way / plan.move, _SHORTEST_MOVE_S)
            arrive_s = start_s + quick * float(rng.uniform(1.0, 1.5))
            leave_s = arrive_s + plan.settle + plan.dwell + 0.1 + float(rng.exponential(0.15))
            self._moves.append((start_s, arrive_s))
            self._way_turns.append(turn)
            self._way_shifts.append(shift)
            rest_s = arrive_s + plan.settle
            stops.append(Stop(visit.pose, visit.visit, start_s, arrive_s, rest_s, leave_s))
            start_s = leave_s
        return tuple(stops)

    def plate_at(self, time_s: Array) -> tuple[Array, Array]:
        """Plate turns (n, 4) and shifts (n, 3) [m] at times (n,) in order, within the rounds so far."""
        turns, shifts = np.empty((len(time_s), 4)), np.empty((len(time_s), 3))
        starts = [start for start, _ in self._moves]
        which = np.searchsorted(starts, time_s, side="right") - 1
        before = which < 0
        turns[before], shifts[before] = self._way_turns[0], self._way_shifts[0]
        for k in np.unique(which[~before]):
            here = which == k
            start, arrive = self._moves[k]
            s = minimum_jerk((time_s[here] - start) / (arrive - start))
            turns[here] = between(self._way_turns[k], self._way_turns[k + 1], s)
            way = self._way_shifts[k + 1] - self._way_shifts[k]
            shifts[here] = self._way_shifts[k] + s[:, None] * way
        return turns, shifts
