"""A mechanism with effects: the plain model, and what every effect adds to it, differentiated.

Parameter vectors are those of the rig's table: the mechanism's N parameters, then each
effect's values (coefficients and settings, in the order of the file). Effects act in the order
parameters -> what channels see -> codes, each on the sum of the ones before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Parameter, Rig, parameters
from solver.effects.effect import Effect, Shift, Site
from solver.effects.registry import effect_kinds
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import EndPose, Linearised, Model, mechanism_model
from solver.mechanism.sensing import Sensing
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_ROUNDS = 30
_SETTLED = 1e-12
"""Newton's last step towards the values behind readings [rad or m]."""


@dataclass(frozen=True)
class Grown:
    """A model with effects.

    Attributes:
        plain: the mechanism with straight sensors; its parameters end with the imperfections.
        site: the rig as the effects see it.
        effects: at work.
        columns: for each effect, (k,) where its coefficients stand in the parameter vector.
        sensing: all channels.
        named: N, parameters of the rig without effects.
        width: of a whole parameter vector.
    """

    plain: Model
    site: Site
    effects: tuple[Effect, ...]
    columns: tuple[NDArray[np.intp], ...]
    sensing: Sensing
    named: int
    width: int

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel names, in the order of readings."""
        return self.plain.channels

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of a pose's coordinates."""
        return self.plain.coordinate_names

    def without_effects(self, space: ParameterSpace) -> tuple[Model, ParameterSpace]:
        """The plain model with the first N parameters, and what of ``space`` it has: for a start."""
        names = {p.name for p in self.site.table}
        kept = [name for name in space.names if name in names]
        plain = mechanism_model(self.site.rig, self.site.table)
        return plain, ParameterSpace.of(space.table[: self.named], kept)

    def linearise(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> Linearised:
        """Predictions and derivatives at ``coordinates`` (P, U) and ``parameters`` (N + k,), along (N + k, n)."""
        where = at or Circumstances()
        base = self._moved(coordinates, parameters, directions, where)
        gains = self.sensing.gain
        gain, by_gain = parameters[gains], directions[gains]
        counts, by_u, by_x = (
            base.readings,
            base.readings_by_coordinates,
            base.readings_by_parameters,
        )
        seeing = [
            (shift, columns)
            for effect, columns in zip(self.effects, self.columns, strict=True)
            if (
                shift := effect.seen(
                    self.sensing.values(counts, parameters[: self.named]),
                    parameters[columns],
                    where,
                )
            )
            is not None
        ]
        if seeing:
            values_by_u = by_u * gain[:, None]
            values_by_x = self.sensing.by_parameters(counts, directions[: self.named]) + (
                by_x * gain[:, None]
            )
            counts, by_u, by_x = counts.copy(), by_u.copy(), by_x.copy()
            for shift, columns in seeing:
                t = shift.targets
                slope = 1.0 / gain[t]
                counts[:, t] += shift.amount * slope
                by_x[:, t] += (shift.by_coefficients @ directions[columns]) * slope[:, None]
                by_x[:, t] -= (shift.amount * slope**2)[:, :, None] * by_gain[t]
                if shift.by_values is not None:
                    by_u[:, t] += (shift.by_values @ values_by_u) * slope[:, None]
                    by_x[:, t] += (shift.by_values @ values_by_x) * slope[:, None]
        for effect, columns in zip(self.effects, self.columns, strict=True):
            coded = effect.coded(counts, parameters[columns], where)
            if coded is not None:
                c = coded.channel
                counts, by_u, by_x = counts.copy(), by_u.copy(), by_x.copy()
                counts[:, c] = coded.counts
                by_u[:, c] *= coded.slope[:, None]
                by_x[:, c] *= coded.slope[:, None]
                by_x[:, c] += coded.by_coefficients @ directions[columns]
        return replace(
            base, readings=counts, readings_by_coordinates=by_u, readings_by_parameters=by_x
        )

    def _moved(
        self, coordinates: Array, parameters: Array, directions: Array, at: Circumstances
    ) -> Linearised:
        """The plain model with each pose's own geometry."""
        geometry = self._geometry(parameters, directions, at, len(coordinates))
        plain = self.plain.linearise(coordinates, geometry.parameters, geometry.directions, at)
        return replace(
            plain,
            readings_by_parameters=geometry.back(plain.readings_by_parameters),
            closure_by_parameters=geometry.back(plain.closure_by_parameters),
        )

    def _geometry(
        self, parameters: Array, directions: Array, at: Circumstances, poses: int
    ) -> _Geometry:
        """Parameters of the plain model as effects move them, and how fast along ``directions`` (N + k, n)."""
        behind = len(self.site.names) - self.named
        x = np.concatenate([parameters[: self.named], np.zeros(behind)])
        along = np.vstack([directions[: self.named], np.zeros((behind, directions.shape[1]))])
        moving = [
            (shift, columns)
            for effect, columns in zip(self.effects, self.columns, strict=True)
            if (shift := effect.moved(parameters[columns], at, poses)) is not None
        ]
        if not moving:
            return _Geometry(x, along, None)
        each = np.tile(x, (poses, 1))
        for shift, _ in moving:
            each[:, shift.targets] += shift.amount * (x[shift.targets] if shift.relative else 1.0)
        targets = np.concatenate([shift.targets for shift, _ in moving])
        single = np.zeros((len(x), len(targets)))
        single[targets, np.arange(len(targets))] = 1.0
        rate = np.concatenate(
            [self._rate(shift, directions[columns], x, along) for shift, columns in moving], axis=1
        )
        return _Geometry(each, np.hstack([along, single]), rate)

    @staticmethod
    def _rate(shift: Shift, directions: Array, parameters: Array, along: Array) -> Array:
        """(P, T, n) how fast a shift of parameters moves them, coefficients along ``directions`` (k, n)."""
        rate = shift.absolute(parameters) @ directions
        if shift.relative:
            rate = rate + shift.amount[:, :, None] * along[shift.targets]
        return np.asarray(rate)

    def values(self, coordinates: Array, parameters: Array, at: Circumstances | None) -> Array:
        """(P, C) true values of the channels' places [rad or m] at ``coordinates`` (P, U)."""
        nowhere = np.zeros((len(parameters), 0))
        plain = self._moved(coordinates, parameters, nowhere, at or Circumstances())
        return self.sensing.values(plain.readings, parameters[: self.named])

    def pseudo_observations(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """The plain model's."""
        return self.plain.pseudo_observations(parameters[: self.named], directions[: self.named])

    def end_pose(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> EndPose:
        """The plain model's, with the geometry that effects give each pose."""
        geometry = self._geometry(parameters, directions, at or Circumstances(), len(coordinates))
        end = self.plain.end_pose(coordinates, geometry.parameters, geometry.directions)
        return replace(end, by_parameters=geometry.back(end.by_parameters))

    def sensed(
        self, counts: Array, parameters: Array, directions: Array, at: Circumstances | None
    ) -> tuple[Array, Array, Array]:
        """What the channels' places do where they read ``counts`` (P, C): the inverse of what is seen.

        Codes are taken as they are: what a rail or a stuck bit hides, no reading tells.

        Returns:
            (P, C) true values [rad or m], (P, C, C) their derivatives with the counts and (P, C, n) along
            ``directions`` (N + k, n).

        Raises:
            MechanismError: an effect is so strong that no value gives such readings.
        """
        where = at or Circumstances()
        read = self.sensing.values(counts, parameters[: self.named])
        values, slope = read, np.eye(read.shape[1])
        for _ in range(_ROUNDS):
            shown, slope, _ = self._seen(values, parameters, where)
            step = np.linalg.solve(slope, (shown - read)[:, :, None])[:, :, 0]
            values = values - step
            if np.abs(step).max(initial=0.0) < _SETTLED:
                break
        else:
            raise MechanismError(
                f"the effects of rig '{self.site.rig.name}' allow no values behind these readings"
            )
        _, slope, shifts = self._seen(values, parameters, where)
        by_parameters = self.sensing.by_parameters(counts, directions[: self.named])
        for shift, columns in shifts:
            by_parameters[:, shift.targets] -= shift.by_coefficients @ directions[columns]
        gains = np.diag(parameters[self.sensing.gain])
        inverse = np.linalg.inv(slope)
        return values, inverse @ gains, inverse @ by_parameters

    def _seen(
        self, values: Array, parameters: Array, at: Circumstances
    ) -> tuple[Array, Array, list[tuple[Shift, NDArray[np.intp]]]]:
        """(P, C) what channels show of ``values`` (P, C), (P, C, C) its slope, and the effects' shifts."""
        shown = values.copy()
        slope = np.tile(np.eye(values.shape[1]), (len(values), 1, 1))
        shifts = []
        for effect, columns in zip(self.effects, self.columns, strict=True):
            shift = effect.seen(values, parameters[columns], at)
            if shift is None:
                continue
            shifts.append((shift, columns))
            shown[:, shift.targets] += shift.amount
            if shift.by_values is not None:
                slope[:, shift.targets] += shift.by_values
        return shown, slope, shifts

    def starts(self, readings: Array, parameters: Array) -> Array:
        """The plain model's."""
        behind = len(self.site.names) - self.named
        x = np.concatenate([parameters[: self.named], np.zeros(behind)])
        return self.plain.starts(readings, x)

    def mobility(self, coordinates: Array, parameters: Array) -> int:
        """The plain model's: effects bend, but free nothing."""
        behind = len(self.site.names) - self.named
        return self.plain.mobility(
            coordinates, np.concatenate([parameters[: self.named], np.zeros(behind)])
        )


@dataclass(frozen=True, slots=True)
class _Geometry:
    """Parameters (N,) of the plain model, or (P, N); directions (N, n + T) to differentiate along.

    ``rate`` (P, T, n), or None, says how fast the T parameters that effects move follow what is asked for.
    """

    parameters: Array
    directions: Array
    rate: Array | None

    def back(self, derivatives: Array) -> Array:
        """(P, K, n) of derivatives (P, K, n + T)."""
        if self.rate is None:
            return derivatives
        asked = self.rate.shape[2]
        return np.asarray(derivatives[:, :, :asked] + derivatives[:, :, asked:] @ self.rate)


def grow(site: Site, effects: Sequence[Effect]) -> tuple[Grown, tuple[Parameter, ...]]:
    """The model of a site with ``effects``, and its parameter table: coefficients behind, all identified.

    Nominal is where a fit begins; settings are the effects' own and take no place in the table.
    """
    table = list(site.table)
    columns = []
    for effect in effects:
        columns.append(np.arange(len(table), len(table) + len(effect.coefficients), dtype=np.intp))
        table += [
            Parameter(f"{effect.label}.{c.name}", c.dimension, c.start, c.plausible, True, None)
            for c in effect.coefficients
        ]
    return _grown(site, effects, columns, len(table)), tuple(table)


def grown_model(rig: Rig) -> Grown:
    """The model of a rig that describes effects.

    Raises:
        MechanismError: an effect that nobody knows, a place or value that it does not have.
    """
    site, kinds = Site(rig), effect_kinds()
    index: Mapping[str, int] = {p.name: i for i, p in enumerate(parameters(rig))}
    effects, columns = [], []
    for entry in rig.effects:
        if entry.name not in kinds:
            raise MechanismError(
                f"rig '{rig.name}' has the effect '{entry.name}', which is not known; "
                f"known are: {', '.join(kinds)}"
            )
        effect = kinds[entry.name].read(site, entry)
        effects.append(effect)
        names = [f"{entry.label}.{c.name}" for c in effect.coefficients]
        columns.append(np.array([index[name] for name in names], dtype=np.intp))
    return _grown(site, effects, columns, len(index))


def _grown(
    site: Site, effects: Sequence[Effect], columns: Sequence[NDArray[np.intp]], width: int
) -> Grown:
    return Grown(
        mechanism_model(site.rig, site.table, imperfect=True),
        site,
        tuple(effects),
        tuple(columns),
        Sensing.of(site.rig, site.table),
        len(site.table),
        width,
    )
