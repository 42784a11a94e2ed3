"""Serial chains closed on themselves: the product of all transforms once around is the identity.

Owns the order of motions around the loop and the closure residual c(u, x) = [p; log R] of
their product, in the frame where the loop starts and ends (Giugovaz & Hollerbach, equation 8,
with the exact logarithm in place of small angles). Where the endpoint is held in a fixture
the loop starts at that fixture: fixture_from_base, base_from_tip, and the freedoms of
fixture_from_tip undone; each fixture is a loop of its own with the same joints.
Endpoint freedoms that the constraint leaves free become unsensed coordinates; where all
three rotations are free, the orientation rows are dropped instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recordings.rig import FREEDOMS, POSE, Parameter, Rig, SerialMechanism, parameters
from solver.errors import MechanismError
from solver.mechanism.chain import Chain, Motion
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.distances import KnownDistances
from solver.mechanism.links import inverse, joint_motions, pose_motions
from solver.mechanism.model import EndPose, Linearised, imperfections
from solver.mechanism.rotation import log_rate, logarithm
from solver.mechanism.sensing import Sensing

Array = NDArray[np.float64]

_ROTATIONS = ("rx", "ry", "rz")
_GRID = {1: 8, 2: 8, 3: 5}  # starts around the circle, by number of unsensed turns


@dataclass(frozen=True, slots=True)
class _Loop:
    """Motions once around a loop, where in them base and endpoint lie, and the freedoms at the end."""

    motions: tuple[Motion, ...]
    base: int
    end: int
    freed: tuple[str, ...]

    def followed(self, coordinates: int) -> Array:
        """(M, U) rate of every motion with every coordinate."""
        out = np.zeros((len(self.motions), coordinates))
        for m, motion in enumerate(self.motions):
            if motion.coordinate >= 0:
                out[m, motion.coordinate] = motion.sign
        return out


def _loop(
    mechanism: SerialMechanism, index: Mapping[str, int], fixture: str | None, turned: bool
) -> _Loop:
    """The loop through ``fixture``, or from the end back to the start; ``turned``: all turns are free.

    Where ``index`` has the mount's imperfections, the fixture can be displaced.
    """
    mount = pose_motions("mount", index) if "mount.x" in index else []
    motions: list[Motion] = []
    base = 0
    if mechanism.base is None and fixture is None:
        motions += inverse(mount)
        base = len(motions)
    for u, joint in enumerate(mechanism.joints):
        motions += joint_motions(joint, index, u)
        if joint.name == mechanism.base:
            motions += inverse(mount) if fixture is None else []
            base = len(motions)
    if mechanism.tip is not None:
        motions += pose_motions("tip", index)
    end = len(motions)
    free = [f for f in FREEDOMS if f in mechanism.closure.freedoms and not (turned and "r" in f)]
    coordinate = {name: len(mechanism.joints) + k for k, name in enumerate(free)}
    shifts = [
        Motion("shift", axis, coordinate=coordinate[name])
        for axis, name in enumerate("xyz")
        if name in coordinate
    ]
    turns = [
        Motion("turn", axis, coordinate=coordinate[name])
        for axis, name in enumerate(_ROTATIONS)
        if name in coordinate
    ]
    if fixture is None:
        return _Loop((*motions, *shifts, *turns), base, end, tuple(free))
    before = inverse(shifts) + inverse(mount) + inverse(pose_motions(fixture, index))
    around = (*before, *motions, *inverse(turns))
    return _Loop(around, len(before) + base, len(before) + end, tuple(free))


@dataclass(frozen=True)
class SerialModel:
    """A closed serial chain with its sensors.

    Attributes:
        chain: all motions once around the loop.
        sensing: the channels.
        sensed: (C,) coordinate that each channel senses.
        coordinate_names: joints in order, then free endpoint freedoms.
        rows: closure rows in use, out of [x, y, z, rx, ry, rz].
        coordinate_of: (M, U), 1 where a motion follows a coordinate.
        parameter_of: (M,) index of each motion's parameter, or -1.
        homes: (U,) coordinates near which the mechanism is assembled.
        base: number of motions before the base frame.
        end: number of motions before the endpoint; free endpoint freedoms come after it.
        fixture_parameters: (F,) indices of the fixtures' parameters.
        distances: what is known of the fixtures' distances.
        elsewhere: the same mechanism held in each of the other fixtures.
    """

    chain: Chain
    sensing: Sensing
    sensed: NDArray[np.intp]
    coordinate_names: tuple[str, ...]
    rows: NDArray[np.intp]
    coordinate_of: Array
    parameter_of: NDArray[np.intp]
    homes: Array
    base: int
    end: int
    fixture_parameters: NDArray[np.intp]
    distances: KnownDistances
    elsewhere: tuple[SerialModel, ...] = ()

    @classmethod
    def of(
        cls, rig: Rig, table: tuple[Parameter, ...] | None = None, *, imperfect: bool = False
    ) -> SerialModel:
        """The model of a serial rig; ``imperfect``: its parameters go on with `imperfections`.

        Raises:
            MechanismError: the rig is not serial.
        """
        mechanism = rig.mechanism
        if not isinstance(mechanism, SerialMechanism):
            raise MechanismError(
                f"rig '{rig.name}' is a {rig.mechanism.family}, expected a serial mechanism"
            )
        table = parameters(rig) if table is None else table
        more = imperfections(rig) if imperfect else ()
        index = {name: i for i, name in enumerate([*(p.name for p in table), *more])}
        turned = mechanism.closure.freedoms >= set(_ROTATIONS)
        rows = [0, 1, 2] if turned else list(range(6))
        loops = [
            _loop(mechanism, index, fixture, turned)
            for fixture in mechanism.fixture_names or (None,)
        ]
        names = [joint.name for joint in mechanism.joints]
        names += [f"end.{name}" for name in loops[0].freed]
        homes = [joint.home.nominal for joint in mechanism.joints] + [0.0] * len(loops[0].freed)
        sensed = np.array([names.index(channel.senses) for channel in rig.channels], dtype=np.intp)
        models = tuple(
            cls(
                Chain(loop.motions),
                Sensing.of(rig, table),
                sensed,
                tuple(names),
                np.array(rows, dtype=np.intp),
                loop.followed(len(names)),
                np.array([motion.parameter for motion in loop.motions], dtype=np.intp),
                np.array(homes),
                loop.base,
                loop.end,
                np.array(
                    [index[f"{name}.{part}"] for name in mechanism.fixture_names for part in POSE],
                    dtype=np.intp,
                ),
                KnownDistances.of(mechanism.distances, index),
            )
            for loop in loops
        )
        return replace(models[0], elsewhere=models[1:])

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel names, in the order of readings."""
        return self.sensing.names

    @cached_property
    def unsensed(self) -> NDArray[np.intp]:
        """Indices of coordinates that no channel senses."""
        return np.setdiff1d(np.arange(len(self.coordinate_names)), self.sensed)

    def linearise(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> Linearised:
        """Predictions and derivatives at ``coordinates`` (P, U) and ``parameters`` (N,), along (N, n).

        ``at`` says in which fixture each pose was held; by default in the first. Where
        parameters are (P, N), geometry differs from pose to pose.
        """
        fixture = None if at is None else at.fixture
        if fixture is not None and fixture.any():
            return self._linearise_in_each(coordinates, parameters, directions, fixture)
        poses, count = coordinates.shape
        counts, slope, by_parameters = self.sensing.counts(
            coordinates[:, self.sensed], parameters, directions
        )
        by_coordinates = np.zeros((poses, len(self.sensed), count))
        by_coordinates[:, np.arange(len(self.sensed)), self.sensed] = slope
        along = self.along(directions)
        moving = np.flatnonzero(self.coordinate_of.any(axis=1) | along.any(axis=1))
        closure, rates = self._closure(coordinates, parameters, moving)
        flat = rates.reshape(-1, len(moving))
        return Linearised(
            counts,
            closure,
            by_coordinates,
            by_parameters,
            (flat @ self.coordinate_of[moving]).reshape(*closure.shape, count),
            (flat @ along[moving]).reshape(*closure.shape, directions.shape[1]),
        )

    def _linearise_in_each(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        fixture: NDArray[np.intp],
    ) -> Linearised:
        """`linearise` of the poses of each fixture, put together again."""
        poses = [np.flatnonzero(fixture == k) for k in range(1 + len(self.elsewhere))]
        parts = [
            model.linearise(
                coordinates[rows],
                parameters if parameters.ndim == 1 else parameters[rows],
                directions,
            )
            for model, rows in zip((self, *self.elsewhere), poses, strict=True)
        ]
        order = np.argsort(np.concatenate(poses), kind="stable")
        return Linearised(
            *(
                np.concatenate([getattr(part, field.name) for part in parts])[order]
                for field in fields(Linearised)
            )
        )

    def pseudo_observations(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """Known distances between fixtures: whitened residuals (D,) and (D, n) derivatives."""
        return self.distances.observe(parameters, directions)

    def along(self, directions: Array) -> Array:
        """(M, n) change of every motion along ``directions`` (N, n)."""
        named = self.parameter_of[:, None] >= 0
        signs = np.array([motion.sign for motion in self.chain.motions])
        return np.where(named, signs[:, None] * directions[self.parameter_of], 0.0)

    def _closure(
        self, coordinates: Array, parameters: Array, moving: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """(P, K) closure and (P, K, M) its rate with the motions ``moving`` (M,) of the chain."""
        reached = self.chain.reach(coordinates, parameters, moving)
        error = np.concatenate([reached.position, np.zeros_like(reached.position)], axis=1)
        rates = reached.screws
        if len(self.rows) == 3:
            return error[:, self.rows], rates[:, self.rows]
        error[:, 3:] = logarithm(reached.rotation)
        rates[:, 3:] = log_rate(error[:, 3:]) @ rates[:, 3:]
        return error, rates

    def end_pose(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> EndPose:
        """End of the chain in the base frame, which lies behind the rig's base joint.

        Parameters are (N,), or (P, N) where geometry differs from pose to pose.
        """
        reached = Chain(self.chain.motions[self.base : self.end]).reach(coordinates, parameters)
        part = slice(self.base, self.end)
        return EndPose(
            reached.rotation,
            reached.position,
            reached.screws @ self.coordinate_of[part],
            reached.screws @ self.along(directions)[part],
        )

    def starts(self, readings: Array, parameters: Array) -> Array:
        """(S, P, U) coordinates: sensed ones from ``readings`` (P, C), unsensed ones around the circle."""
        base = np.tile(self.homes, (len(readings), 1))
        base[:, self.sensed] = self.sensing.values(readings, parameters)
        unsensed = self.unsensed
        if not len(unsensed):
            return base[None]
        turns = [j for j in unsensed if self._turns(int(j))][:3]
        if not turns:
            return base[None]
        around = np.linspace(0, 2 * np.pi, _GRID[len(turns)], endpoint=False)
        grid = np.stack(np.meshgrid(*[around] * len(turns), indexing="ij"), axis=-1).reshape(
            -1, len(turns)
        )
        out = np.tile(base, (len(grid), 1, 1))
        for column, j in enumerate(turns):
            out[:, :, j] += grid[:, None, column]
        return out

    def _turns(self, coordinate: int) -> bool:
        return any(m.kind == "turn" for m in self.chain.motions if m.coordinate == coordinate)

    def mobility(self, coordinates: Array, parameters: Array) -> int:
        """Freedoms of the closed mechanism: coordinates minus the rank of the closure's Jacobian."""
        jacobian = self.linearise(
            coordinates, parameters, np.zeros((len(parameters), 0))
        ).closure_by_coordinates
        singular = np.linalg.svd(jacobian, compute_uv=False)
        rank = int(np.median((singular > 1e-6 * singular[:, :1]).sum(axis=1)))
        return len(self.coordinate_names) - rank
