"""Platforms: legs of sensed length between points of a base and points of a plate.

length_i = |t + R b_i - a_i|. The plate's coordinates are its rotation vector phi (R =
exp(phi) times the neutral rotation) and its translation from the neutral position, or those
of the two that its kind leaves free. There is no closure residual: redundancy is more legs
than freedoms. No sign is ever chosen: which of several assemblies a pose is in follows from
where its search starts (`starts`, and neighbouring poses in `estimate.nuisance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Leg, Parameter, PlatformMechanism, Rig, parameters
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import EndPose, Linearised, imperfections
from solver.mechanism.rotation import exponential, left_jacobian, skew
from solver.mechanism.sensing import Sensing

Array = NDArray[np.float64]

_FOLLOWING_STEPS = 10  # from the neutral pose to a reading, so that no step leaves the branch
_CORRECTIONS = 3
_DAMPING = 1e-3  # of each correction, so that a pose near a singular one does not jump


@dataclass(frozen=True, slots=True)
class _Imperfections:
    """Indices of displacements: (3,) of the plate's pivot, (C, 3) of each leg's two ends."""

    mount: NDArray[np.intp]
    base: NDArray[np.intp]
    plate: NDArray[np.intp]

    @classmethod
    def of(cls, rig: Rig, behind: int, legs: Sequence[Leg]) -> _Imperfections:
        """Those that stand ``behind`` parameters, for the legs of the channels."""
        index = {name: behind + i for i, name in enumerate(imperfections(rig))}
        ends = [
            [[index[f"{leg.name}.{end}.{axis}"] for axis in "xyz"] for leg in legs]
            for end in ("base", "plate")
        ]
        mount = np.array([index[f"mount.{axis}"] for axis in "xyz"], dtype=np.intp)
        return cls(mount, np.array(ends[0], dtype=np.intp), np.array(ends[1], dtype=np.intp))


@dataclass(frozen=True)
class PlatformModel:
    """A platform with its sensors.

    Attributes:
        sensing: the channels.
        base: (C, 3) indices of each channel's base point in the parameter vector.
        plate: (C, 3) indices of its plate point.
        turns: whether the plate rotates.
        shifts: whether the plate translates.
        neutral_rotation: (3, 3), base from plate.
        neutral_position: (3,) [m].
        from_neutral: whether channels sense a leg's length minus its length at the neutral pose.
        imperfect: where parameter vectors have displacements that only effects move, or None.
    """

    sensing: Sensing
    base: NDArray[np.intp]
    plate: NDArray[np.intp]
    turns: bool
    shifts: bool
    neutral_rotation: Array
    neutral_position: Array
    from_neutral: bool
    imperfect: _Imperfections | None = None

    @classmethod
    def of(
        cls, rig: Rig, table: tuple[Parameter, ...] | None = None, *, imperfect: bool = False
    ) -> PlatformModel:
        """The model of a platform rig; ``imperfect``: its parameters go on with `imperfections`.

        Raises:
            MechanismError: the rig is not a platform.
        """
        mechanism = rig.mechanism
        if not isinstance(mechanism, PlatformMechanism):
            raise MechanismError(
                f"rig '{rig.name}' is a {rig.mechanism.family}, expected a platform"
            )
        table = parameters(rig) if table is None else table
        index = {parameter.name: i for i, parameter in enumerate(table)}
        legs = {leg.name: leg for leg in mechanism.legs}
        ends = [legs[channel.senses] for channel in rig.channels]
        turns, shifts = mechanism.plate != "point", mechanism.plate != "pivoted"
        neutral = mechanism.neutral
        turn = exponential(np.diag([neutral.rx, neutral.ry, neutral.rz]))
        return cls(
            Sensing.of(rig, table),
            np.array(
                [[index[f"{leg.base}.{axis}"] for axis in "xyz"] for leg in ends], dtype=np.intp
            ),
            np.array(
                [[index[f"{leg.plate}.{axis}"] for axis in "xyz"] for leg in ends], dtype=np.intp
            ),
            turns,
            shifts,
            turn[2] @ turn[1] @ turn[0] if turns else np.eye(3),
            np.array([neutral.x, neutral.y, neutral.z]) * shifts,
            mechanism.leg_readings == "change",
            _Imperfections.of(rig, len(table), ends) if imperfect else None,
        )

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel names, in the order of readings."""
        return self.sensing.names

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of a pose's coordinates."""
        return (("plate.rx", "plate.ry", "plate.rz") if self.turns else ()) + (
            ("plate.x", "plate.y", "plate.z") if self.shifts else ()
        )

    def plate_pose(self, coordinates: Array) -> tuple[Array, Array]:
        """Rotation (P, 3, 3), base from plate, and position (P, 3) [m] at ``coordinates`` (P, U)."""
        poses = len(coordinates)
        rotation = np.tile(self.neutral_rotation, (poses, 1, 1))
        if self.turns:
            rotation = exponential(coordinates[:, :3]) @ rotation
        moved = coordinates[:, -3:] if self.shifts else np.zeros((poses, 3))
        return rotation, self.neutral_position + moved

    def linearise(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> Linearised:
        """Predictions and derivatives at ``coordinates`` (P, U) and ``parameters`` (N,), along (N, n).

        Circumstances say nothing here: a platform has no fixtures. Where parameters are (P, N),
        geometry differs from pose to pose.
        """
        poses, size = coordinates.shape
        rotation, position = self.plate_pose(coordinates)
        arm, along, length, by_length = self._legs(rotation, position, parameters, directions)
        if self.from_neutral:
            still = self.neutral_rotation[None], self.neutral_position[None]
            _, _, at_neutral, by_neutral = self._legs(*still, parameters, directions)
            length, by_length = length - at_neutral, by_length - by_neutral
        counts, slope, by_parameters = self.sensing.counts(length, parameters, directions)

        by_coordinates = np.zeros((poses, slope.shape[-1], size))
        if self.turns:
            turned = -skew(arm) @ left_jacobian(coordinates[:, None, :3])
            by_coordinates[:, :, :3] = np.einsum("pci,pcij->pcj", along, turned)
        if self.shifts:
            by_coordinates[:, :, -3:] = along
        return Linearised(
            counts,
            np.zeros((poses, 0)),
            by_coordinates * slope[..., None],
            by_parameters + by_length * slope[..., None],
            np.zeros((poses, 0, size)),
            np.zeros((poses, 0, directions.shape[1])),
        )

    def _legs(
        self, rotation: Array, position: Array, parameters: Array, directions: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Plate points turned into the base and unit vectors along the legs, (P, C, 3); lengths
        (P, C) [m] and their derivatives (P, C, n) at fixed plate poses."""
        plate, base = parameters[..., self.plate], parameters[..., self.base]
        plates, bases = directions[self.plate], directions[self.base]
        if self.imperfect is not None:
            # To shift the plate is to shift all base points the other way.
            more = self.imperfect
            plate = plate + parameters[..., more.plate]
            base = base + parameters[..., more.base] - parameters[..., None, more.mount]
            plates = plates + directions[more.plate]
            bases = bases + directions[more.base] - directions[more.mount]
        arm = plate @ np.swapaxes(rotation, 1, 2)
        leg = position[:, None] + arm - base
        length = np.linalg.norm(leg, axis=2)
        along = leg / length[:, :, None]
        by_length = np.einsum("pck,ckn->pcn", along @ rotation, plates)
        by_length -= np.einsum("pck,ckn->pcn", along, bases)
        return arm, along, length, by_length

    def pseudo_observations(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """A platform knows nothing beside its readings: empty (0,) and (0, n)."""
        return np.zeros(0), np.zeros((0, directions.shape[1]))

    def end_pose(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> EndPose:
        """The plate in the base frame; no parameter moves it at fixed coordinates."""
        rotation, position = self.plate_pose(coordinates)
        by_coordinates = np.zeros((len(coordinates), 6, coordinates.shape[1]))
        if self.turns:
            by_coordinates[:, 3:, :3] = left_jacobian(coordinates[:, :3])
        if self.shifts:
            by_coordinates[:, :3, -3:] = np.eye(3)
        still = np.zeros((len(coordinates), 6, directions.shape[1]))
        return EndPose(rotation, position, by_coordinates, still)

    def starts(self, readings: Array, parameters: Array) -> Array:
        """(S, P, U) coordinates: followed from neutral, neutral, then turned or moved in each direction."""
        size = len(self.coordinate_names)
        reach = float(np.abs(parameters[self.base]).max())
        span = np.array([1.0] * 3 * self.turns + [0.3 * reach] * 3 * self.shifts)
        offsets = np.vstack(
            [np.zeros(size), *(sign * np.diag(span) for sign in (0.7, -0.7, 1.6, -1.6))]
        )
        others = np.tile(offsets[:, None, :], (1, len(readings), 1))
        return np.concatenate([self._followed(readings, parameters)[None], others])

    def _followed(self, readings: Array, parameters: Array) -> Array:
        """(P, U) coordinates reached from neutral as the readings go straight to ``readings`` (P, C).

        The assembly stays the one that the neutral pose is in, as that of a platform in use does.
        """
        u = np.zeros((len(readings), len(self.coordinate_names)))
        nowhere = np.zeros((len(parameters), 0))
        begin = self.linearise(u, parameters, nowhere).readings
        for share in np.linspace(0.0, 1.0, _FOLLOWING_STEPS + 1)[1:]:
            target = begin + share * (readings - begin)
            for _ in range(_CORRECTIONS):
                at = self.linearise(u, parameters, nowhere)
                slope = at.readings_by_coordinates
                transposed = np.swapaxes(slope, 1, 2)
                normal = transposed @ slope
                diagonal = np.einsum("puu->pu", normal)
                diagonal *= 1.0 + _DAMPING
                diagonal += 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
                pull = transposed @ (target - at.readings)[:, :, None]
                u = u + np.linalg.solve(normal, pull)[:, :, 0]
        return u

    def mobility(self, coordinates: Array, parameters: Array) -> int:
        """Freedoms of the plate."""
        return len(self.coordinate_names)
