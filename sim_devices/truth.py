"""What the rig really is: the numbers that nature draws, and the file that tells them.

Owns the truth file. Truth never enters a recording: it goes only to a file of its own that
is asked for.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from recordings.rig import Parameter, Rig, SerialMechanism, parameters
from sim_devices.plant.errors import CannotSimulate, TruthNotWritten
from sim_devices.plant.seeds import PARAMETERS, stream

SCHEMA = 1

_ROUNDS = 40
_KEPT = 1e-12
"""Distances of fixtures are kept to this [m]."""


@dataclass(frozen=True, slots=True)
class HiddenEffect:
    """An effect at work in nature, as the truth file tells it.

    Attributes:
        name: from the catalogue of effects.
        where: the rig's own name of the place.
        size: in ``unit``; of a shape its RMS over the poses of the plan.
        unit: "deg", "m", or "1" for a ratio.
    """

    name: str
    where: str
    size: float
    unit: str


@dataclass(frozen=True, slots=True)
class Truth:
    """Every parameter of a rig as it really is.

    Attributes:
        seed: what it was drawn with.
        parameters: value of each parameter of `recordings.rig.parameters`, SI.
        units: unit in which each is shown, with its factor to SI.
        effects: what else is at work.
    """

    seed: int
    parameters: Mapping[str, float]
    units: Mapping[str, tuple[str, float]]
    effects: tuple[HiddenEffect, ...] = ()


def draw_truth(rig: Rig, seed: int) -> Truth:
    """Nominal values, moved by N(0, uncertainty) where a calibration is to find them out.

    A parameter is drawn when the rig identifies it and states its uncertainty; others stay
    nominal; tied ones follow. Fixtures whose distance the rig knows are then moved, as little
    as their uncertainties ask, until it is what was measured, give or take its own uncertainty.

    Raises:
        CannotSimulate: no places of the fixtures have the stated distances.
    """
    rng = stream(seed, PARAMETERS)
    table = parameters(rig)
    drawn: dict[str, float] = {}
    for parameter in table:
        # One draw for each, used or not, so that a flag in the rig does not move the others.
        deviation = rng.standard_normal()
        spread = parameter.uncertainty if parameter.identify and parameter.uncertainty else 0.0
        drawn[parameter.name] = parameter.nominal + spread * float(deviation)
    if isinstance(rig.mechanism, SerialMechanism) and rig.mechanism.distances:
        _keep_distances(rig.mechanism, table, drawn, rng)
    values = {
        p.name: drawn[p.name] if p.tie is None else p.tie.factor * drawn[p.tie.parameter]
        for p in table
    }
    units = {parameter.name: (parameter.unit, parameter.to_si) for parameter in table}
    return Truth(seed, MappingProxyType(values), MappingProxyType(units))


def _keep_distances(
    mechanism: SerialMechanism,
    table: Sequence[Parameter],
    drawn: dict[str, float],
    rng: np.random.Generator,
) -> None:
    """Move drawn fixtures by least squares (Gauss-Newton, weighted) to their known distances."""
    names = [f"{fixture}.{axis}" for fixture in mechanism.fixture_names for axis in "xyz"]
    given = {parameter.name: parameter for parameter in table}
    spread = np.array(
        [
            (given[n].uncertainty or 0.0) * (given[n].identify and given[n].tie is None)
            for n in names
        ]
    )
    ends = np.array([[names.index(f"{end}.x") for end in d.between] for d in mechanism.distances])
    measured = [d.distance for d in mechanism.distances]
    true = np.array([m.nominal + (m.uncertainty or 0.0) * rng.standard_normal() for m in measured])
    movable = np.array([bool(spread[[a, a + 1, a + 2, b, b + 1, b + 2]].any()) for a, b in ends])
    ends, true = ends[movable], true[movable]
    at = np.array([drawn[name] for name in names])
    corner = np.arange(3)
    for _ in range(_ROUNDS):
        apart = at[ends[:, :1] + corner] - at[ends[:, 1:] + corner]
        length = np.maximum(np.linalg.norm(apart, axis=1), 1e-12)
        off = length - true
        if np.abs(off).max(initial=0.0) < _KEPT:
            drawn.update(zip(names, at.tolist(), strict=True))
            return
        rows = np.zeros((len(ends), len(names)))
        for row, (a, b), along in zip(rows, ends, apart / length[:, None], strict=True):
            row[a + corner], row[b + corner] = along, -along
        rows *= spread
        at = at - spread * (np.linalg.pinv(rows, rcond=1e-9) @ off)
    raise CannotSimulate(
        f"no places of the fixtures near their nominal ones have the stated distances: {np.abs(off).max():.3g} m "
        "remain; check the distances, and which coordinates of the fixtures have an uncertainty"
    )


def truth_json(truth: Truth) -> str:
    """The truth file: schema, seed, parameters in shown units (m, deg, ...), effects."""
    document = {
        "schema": SCHEMA,
        "seed": truth.seed,
        "parameters": {n: v / truth.units[n][1] for n, v in truth.parameters.items()},
        "effects": [
            {"name": e.name, "where": e.where, "size": e.size, "unit": e.unit}
            for e in truth.effects
        ],
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def refuse_to_overwrite(path: str | Path) -> None:
    """Ask, before long work, whether a truth file could be created; raises TruthNotWritten."""
    if Path(path).exists():
        raise TruthNotWritten(
            f"'{path}' exists already, and a truth file never replaces another; "
            "choose another name or move it away"
        )


def write_truth(truth: Truth, path: str | Path) -> None:
    """Write the truth file at ``path``.

    Raises:
        TruthNotWritten: something is there already, or the file cannot be written.
    """
    refuse_to_overwrite(path)
    try:
        with Path(path).open("x", encoding="utf-8") as file:
            file.write(truth_json(truth))
    except OSError as error:
        raise TruthNotWritten(f"cannot write the truth file '{path}': {error}") from error
