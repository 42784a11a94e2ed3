"""Serial chains closed on themselves: the product of all joint transforms is the identity.

Owns the translation of a rig's joints into elementary motions and the closure residual
c(u, x) = [p; log R] of the end transform, in the frame where the loop starts and ends
(Giugovaz & Hollerbach, equation 8, with the exact logarithm in place of small angles).
Endpoint freedoms that the constraint leaves free become unsensed coordinates; where all
three rotations are free, the orientation rows are dropped instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Parameter, Rig, SerialMechanism, parameters
from solver.errors import MechanismError
from solver.mechanism.chain import Chain, Motion
from solver.mechanism.model import EndPose, Linearised
from solver.mechanism.rotation import log_rate, logarithm
from solver.mechanism.sensing import Sensing

Array = NDArray[np.float64]

_ROTATIONS = ("rx", "ry", "rz")
_GRID = 8  # starts around the circle for each unsensed coordinate


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

    @classmethod
    def of(cls, rig: Rig, table: tuple[Parameter, ...] | None = None) -> SerialModel:
        """The model of a serial rig.

        Raises:
            MechanismError: the rig is not serial.
        """
        mechanism = rig.mechanism
        if not isinstance(mechanism, SerialMechanism):
            raise MechanismError(
                f"rig '{rig.name}' is a {rig.mechanism.family}, expected a serial mechanism"
            )
        table = parameters(rig) if table is None else table
        index = {parameter.name: i for i, parameter in enumerate(table)}
        motions: list[Motion] = []
        base = 0
        for u, joint in enumerate(mechanism.joints):
            turning = joint.type == "revolute"
            part = {
                name: index[f"{joint.name}.{name}"] for name in ("theta_offset", "s", "a", "alpha")
            }
            motions += [
                Motion("turn", 2, part["theta_offset"], u if turning else -1),
                Motion("shift", 2, part["s"], -1 if turning else u),
                Motion("shift", 0, part["a"]),
                Motion("turn", 0, part["alpha"]),
            ]
            if joint.name == mechanism.base:
                base = len(motions)
        end = len(motions)
        names = [joint.name for joint in mechanism.joints]
        homes = [joint.home.nominal for joint in mechanism.joints]
        freedoms = mechanism.closure.freedoms
        rows = list(range(6))
        if freedoms >= set(_ROTATIONS):
            freedoms, rows = freedoms - set(_ROTATIONS), [0, 1, 2]
        for axis, letter in enumerate("xyz"):
            if letter in freedoms:
                motions.append(Motion("shift", axis, coordinate=len(names)))
                names.append(f"end.{letter}")
                homes.append(0.0)
        for axis, name in enumerate(_ROTATIONS):
            if name in freedoms:
                motions.append(Motion("turn", axis, coordinate=len(names)))
                names.append(f"end.{name}")
                homes.append(0.0)
        sensed = np.array([names.index(channel.senses) for channel in rig.channels], dtype=np.intp)
        coordinate_of = np.zeros((len(motions), len(names)))
        for m, motion in enumerate(motions):
            if motion.coordinate >= 0:
                coordinate_of[m, motion.coordinate] = 1.0
        return cls(
            Chain(tuple(motions)),
            Sensing.of(rig, table),
            sensed,
            tuple(names),
            np.array(rows, dtype=np.intp),
            coordinate_of,
            np.array([motion.parameter for motion in motions], dtype=np.intp),
            np.array(homes),
            base,
            end,
        )

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel names, in the order of readings."""
        return self.sensing.names

    @property
    def unsensed(self) -> NDArray[np.intp]:
        """Indices of coordinates that no channel senses."""
        return np.setdiff1d(np.arange(len(self.coordinate_names)), self.sensed)

    def linearise(self, coordinates: Array, parameters: Array, directions: Array) -> Linearised:
        """Predictions and derivatives at ``coordinates`` (P, U) and ``parameters`` (N,), along (N, n)."""
        poses, count = coordinates.shape
        counts, slope, by_parameters = self.sensing.counts(
            coordinates[:, self.sensed], parameters, directions
        )
        by_coordinates = np.zeros((poses, len(self.sensed), count))
        by_coordinates[:, np.arange(len(self.sensed)), self.sensed] = slope
        closure, rates = self._closure(coordinates, parameters)
        return Linearised(
            counts,
            closure,
            by_coordinates,
            by_parameters,
            rates @ self.coordinate_of,
            rates @ self.along(directions),
        )

    def along(self, directions: Array) -> Array:
        """(M, n) change of every motion along ``directions`` (N, n)."""
        return np.where(self.parameter_of[:, None] >= 0, directions[self.parameter_of], 0.0)

    def _closure(self, coordinates: Array, parameters: Array) -> tuple[Array, Array]:
        """(P, K) closure and (P, K, M) its rate with every motion of the chain."""
        reached = self.chain.reach(coordinates, parameters)
        error = np.concatenate([reached.position, np.zeros_like(reached.position)], axis=1)
        rates = reached.screws
        if len(self.rows) > 3:
            error[:, 3:] = logarithm(reached.rotation)
            rates = rates.copy()
            rates[:, 3:] = log_rate(error[:, 3:]) @ rates[:, 3:]
        return error[:, self.rows], rates[:, self.rows]

    def end_pose(self, coordinates: Array, parameters: Array, directions: Array) -> EndPose:
        """End of the chain in the base frame, which lies behind the rig's base joint."""
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
        around = np.linspace(0, 2 * np.pi, _GRID, endpoint=False)
        turns = [j for j in unsensed if self._turns(int(j))][:2]
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
