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
        poses, wide = len(coordinates), directions.shape[1]
        behind = len(self.site.names) - self.named
        x = np.concatenate([parameters[: self.named], np.zeros(behind)])
        along = np.vstack([directions[: self.named], np.zeros((behind, wide))])
        moving = [
            (shift, columns)
            for effect, columns in zip(self.effects, self.columns, strict=True)
            if (shift := effect.moved(parameters[columns], at, poses)) is not None
        ]
        if not moving:
            return self.plain.linearise(coordinates, x, along, at)
        each = np.tile(x, (poses, 1))
        for shift, _ in moving:
            each[:, shift.targets] += shift.amount * (x[shift.targets] if shift.relative else 1.0)
        targets = np.concatenate([shift.targets for shift, _ in moving])
        single = np.zeros((len(x), len(targets)))
        single[targets, np.arange(len(targets))] = 1.0
        plain = self.plain.linearise(coordinates, each, np.hstack([along, single]), at)
        rate = np.concatenate(
            [self._rate(shift, directions[columns], x, along) for shift, columns in moving], axis=1
        )
        readings, closure = plain.readings_by_parameters, plain.closure_by_parameters
        return replace(
            plain,
            readings_by_parameters=readings[:, :, :wide] + readings[:, :, wide:] @ rate,
            closure_by_parameters=closure[:, :, :wide] + closure[:, :, wide:] @ rate,
        )

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

    def end_pose(self, coordinates: Array, parameters: Array, directions: Array) -> EndPose:
        """The plain model's: where the end is, is a matter of the geometry, not of what is seen."""
        behind = len(self.site.names) - self.named
        x = np.concatenate([parameters[: self.named], np.zeros(behind)])
        along = np.vstack([directions[: self.named], np.zeros((behind, directions.shape[1]))])
        return self.plain.end_pose(coordinates, x, along)

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
