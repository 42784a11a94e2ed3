"""``link-geometry``: a parameter of the mechanism that is held fixed is not what the rig says.

Held parameters that change the readings in the same way as what is identified, or as an earlier
held one together with what is identified, are no places of their own: the zero of an unsensed
joint, or the second of two lengths that only set the scale together. Which those are is found
from the model: coordinates and identified parameters are eliminated from its derivatives at
closed poses near home, and columns that vanish, or lie along an earlier one, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, SerialMechanism
from solver.effects.axis_offset import meeting_axes
from solver.effects.effect import Array, Coefficient, Effect, Shift, Site
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import Model, mechanism_model
from solver.mechanism.space import ParameterSpace

_POSES = 60
_AWAY = 0.35  # rad, or share of a length, that poses lie from home
_CLOSES = 1e-9
_VANISHES = 1e-6  # of a column, left after elimination
_ALONG = 1e-8  # 1 - cosine of columns that are the same


class LinkGeometry(Effect):
    """The parameter is larger than stated by ``change``."""

    name = "link-geometry"

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        self._parameter = site.table[site.parameter(where)]
        self._targets, self._factors = _with_followers(site, where)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        return tuple(twins(site))

    @classmethod
    def read(cls, site: Site, described: DescribedEffect) -> Self:
        if described.where not in _held(site):
            raise MechanismError(
                f"the effect '{described.name}' of rig '{site.rig.name}' sits at '{described.where}', expected a "
                f"parameter that is held fixed: {', '.join(_held(site))}"
            )
        return cls(site, described.where).fitting(described)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        length = self._parameter.dimension == "length"
        return (Coefficient("change", self._parameter.dimension, 2e-3 if length else 0.01),)

    def moved(self, coefficients: Array, at: Circumstances, poses: int) -> Shift | None:
        each = np.tile(self._factors, (poses, 1))
        return Shift(self._targets, coefficients[0] * each, each[:, :, None])

    def size(self, coefficients: Array, values: Array, at: Circumstances) -> float:
        return float(coefficients[0])


def _held(site: Site) -> tuple[str, ...]:
    """Parameters of the mechanism that are neither identified nor tied, `axis-offset`'s left out."""
    mechanism = site.rig.mechanism
    if isinstance(mechanism, SerialMechanism):
        owners = {*mechanism.places, *mechanism.fixture_names, "tip"}
    else:
        owners = {point.name for point in (*mechanism.base_points, *mechanism.plate_points)}
    meeting = {f"{joint}.a" for joint in meeting_axes(site)}
    return tuple(
        p.name
        for p in site.table
        if p.name.rpartition(".")[0] in owners
        and not p.identify
        and p.tie is None
        and p.name not in meeting
    )


def _with_followers(
    site: Site, where: str
) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], Array]:
    """Indices of a parameter and of all that is tied to it, and how far each moves with it."""
    targets, factors = [site.parameter(where)], [1.0]
    for i, p in enumerate(site.table):
        if p.tie is not None and p.tie.parameter == where:
            targets.append(i)
            factors.append(p.tie.factor)
    return np.array(targets, dtype=np.intp), np.array(factors)


@lru_cache(maxsize=8)
def twins(site: Site) -> Mapping[str, tuple[str, ...]]:
    """Held parameters that can be told from what is identified and from each other.

    Each with the later ones that no reading could tell from it, for which it stands.
    """
    held = _held(site)
    space = ParameterSpace.of(site.table)
    model = mechanism_model(site.rig, site.table)
    columns = np.zeros((len(site.table), len(held)))
    for k, name in enumerate(held):
        targets, factors = _with_followers(site, name)
        columns[targets, k] = factors
    directions = np.hstack([space.expansion, columns])
    rows = _seen(model, space.nominal, directions, _closed_poses(model, space.nominal))
    known = rows[:, : len(space.names)]
    left, singular, _ = np.linalg.svd(known, full_matrices=False)
    basis = left[:, singular > _VANISHES * singular.max(initial=1.0)]
    rest = rows[:, len(space.names) :]
    rest = rest - basis @ (basis.T @ rest)
    length = np.linalg.norm(rest, axis=0)
    unit = rest / np.where(length > 0, length, 1.0)
    kept: dict[int, tuple[str, ...]] = {}
    for k in np.flatnonzero(length > _VANISHES).tolist():
        same = [j for j in kept if 1.0 - abs(float(unit[:, k] @ unit[:, j])) < _ALONG]
        if same:
            kept[same[0]] += (held[k],)
        else:
            kept[k] = ()
    return {held[k]: others for k, others in kept.items()}


def _closed_poses(model: Model, parameters: Array) -> Array:
    """(P, U) closed poses around home."""
    size = len(model.coordinate_names)
    homes = getattr(model, "homes", np.zeros(size))
    u = homes + _AWAY * np.random.default_rng(0).uniform(-1.0, 1.0, (_POSES, size))
    nowhere = np.zeros((len(parameters), 0))
    for _ in range(30):
        at = model.linearise(u, parameters, nowhere)
        if not at.closure.shape[1]:
            return u
        inverse = np.linalg.pinv(at.closure_by_coordinates, rcond=1e-6)
        step = (inverse @ at.closure[:, :, None])[:, :, 0]
        u = u - np.clip(step, -0.3, 0.3)
    at = model.linearise(u, parameters, nowhere)
    return np.asarray(u[np.abs(at.closure).max(axis=1) < _CLOSES])


def _seen(model: Model, parameters: Array, directions: Array, u: Array) -> Array:
    """(rows, n) derivatives of readings and closure at poses ``u``, coordinates eliminated.

    In units in which each column is 1 long before the elimination.
    """
    at = model.linearise(u, parameters, directions)
    counts = np.linalg.norm(at.readings_by_coordinates, axis=2, keepdims=True)
    scale = 1.0 / np.where(counts > 0, counts, 1.0)
    by_u = np.concatenate([at.readings_by_coordinates * scale, at.closure_by_coordinates], axis=1)
    by_x = np.concatenate([at.readings_by_parameters * scale, at.closure_by_parameters], axis=1)
    by_known = model.pseudo_observations(parameters, directions)[1]
    sizes = np.sqrt(np.sum(by_x**2, axis=(0, 1)) + np.sum(by_known**2, axis=0))
    by_x = by_x - by_u @ (np.linalg.pinv(by_u, rcond=1e-8) @ by_x)
    rows = np.vstack([by_x.reshape(-1, directions.shape[1]), by_known])
    return np.asarray(rows / np.where(sizes > 0, sizes, 1.0))
