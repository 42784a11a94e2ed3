"""Closed configurations of a mechanism: assembling it, and wandering over what it can reach.

Owns the search for closed configurations without readings (there is nothing measured yet):
Newton steps of least motion onto c(u, x) = 0, and random walks along it inside the joint
limits. Used to check a rig, to plan a session and to predict what it will determine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recordings.rig import PlatformMechanism, Rig, SerialMechanism
from solver.errors import MechanismError
from solver.mechanism.model import Model
from solver.mechanism.rotation import exponential, logarithm

Array = NDArray[np.float64]

_CLOSED = 1e-10
_DEFAULT_TURN = 0.5  # rad a plate turns where the plan says nothing
_STEP = 0.15  # rad or m a walker moves between two configurations


def close(
    model: Model, coordinates: Array, parameters: Array, *, iterations: int = 60
) -> tuple[Array, NDArray[np.bool_]]:
    """Nearest closed configurations to ``coordinates`` (P, U), and which of them were found (P,)."""
    u = coordinates.copy()
    nowhere = np.zeros((len(parameters), 0))
    for _ in range(iterations):
        at = model.linearise(u, parameters, nowhere)
        if at.closure.shape[1] == 0 or np.abs(at.closure).max(initial=0.0) < 0.01 * _CLOSED:
            break
        step = -(np.linalg.pinv(at.closure_by_coordinates, rcond=1e-9) @ at.closure[:, :, None])[
            :, :, 0
        ]
        largest = np.abs(step).max(axis=1, keepdims=True)
        u = u + step * np.minimum(1.0, 0.3 / np.maximum(largest, 1e-300))
    error = np.abs(model.linearise(u, parameters, nowhere).closure).max(axis=1, initial=0.0)
    return u, error < _CLOSED


def limits(rig: Rig, model: Model) -> tuple[Array, Array]:
    """Lowest and highest (U,) value of every coordinate; infinite where the rig states none."""
    low, high = (
        np.full(len(model.coordinate_names), -np.inf),
        np.full(len(model.coordinate_names), np.inf),
    )
    if isinstance(rig.mechanism, SerialMechanism):
        for j, joint in enumerate(rig.mechanism.joints):
            if joint.limits is not None:
                low[j], high[j] = joint.limits.low, joint.limits.high
    return low, high


def assembled(rig: Rig, model: Model, parameters: Array) -> Array:
    """(U,) a closed configuration near the rig's home.

    Raises:
        MechanismError: none was found; the message says how far from closing the nearest is.
    """
    count = len(model.coordinate_names)
    if not isinstance(rig.mechanism, SerialMechanism):
        return np.zeros(count)
    home = np.zeros(count)
    home[: len(rig.mechanism.joints)] = [joint.home.nominal for joint in rig.mechanism.joints]
    rng = np.random.default_rng(0)
    tries = home + np.concatenate([np.zeros((1, count)), 0.5 * rng.standard_normal((100, count))])
    found, closed = close(model, tries, parameters)
    if not closed.any():
        error = (
            np.abs(model.linearise(found, parameters, np.zeros((len(parameters), 0))).closure)
            .max(axis=1)
            .min()
        )
        raise MechanismError(
            f"the mechanism of rig '{rig.name}' does not close: the best configuration found near its home is "
            f"{error:.3g} (m or rad) from closing. Check lengths, angles and home values."
        )
    distance = np.linalg.norm(found - home, axis=1)
    return np.asarray(found[np.argmin(np.where(closed, distance, np.inf))])


def wander(rig: Rig, model: Model, parameters: Array, count: int, *, seed: int) -> Array:
    """(count, U) closed configurations spread over what is reachable from home inside the limits."""
    rng = np.random.default_rng(seed)
    if isinstance(rig.mechanism, PlatformMechanism):
        return _turned(rig, model, count, rng)
    low, high = limits(rig, model)
    # A joint without limits may turn once around.
    home = assembled(rig, model, parameters)
    low, high = np.maximum(low, home - np.pi), np.minimum(high, home + np.pi)
    walkers = np.tile(home, (max(8, count // 20), 1))
    visited: list[Array] = []
    heading = rng.standard_normal(walkers.shape)
    while sum(len(v) for v in visited) < count:
        jacobian = model.linearise(
            walkers, parameters, np.zeros((len(parameters), 0))
        ).closure_by_coordinates
        along = np.eye(walkers.shape[1]) - np.linalg.pinv(jacobian, rcond=1e-9) @ jacobian
        heading = heading + 0.5 * rng.standard_normal(walkers.shape)
        step = (along @ heading[:, :, None])[:, :, 0]
        norm = np.linalg.norm(step, axis=1, keepdims=True)
        moved, closed = close(
            model, walkers + _STEP * step / np.maximum(norm, 1e-9), parameters, iterations=8
        )
        inside = closed & ((moved >= low) & (moved <= high)).all(axis=1)
        near = np.abs(moved - walkers).max(axis=1) < 3 * _STEP
        walkers[inside & near] = moved[inside & near]
        heading[~(inside & near)] = -heading[~(inside & near)]
        visited.append(walkers.copy())
    every = np.vstack(visited)
    return every[rng.choice(len(every), size=count, replace=False)]


def _turned(rig: Rig, model: Model, count: int, rng: np.random.Generator) -> Array:
    """Plate coordinates within the plan's tilt and swivel, and a tenth of the base's size sideways."""
    plan, mechanism = rig.plan, rig.mechanism
    assert isinstance(mechanism, PlatformMechanism)
    tilt, swivel = (
        _DEFAULT_TURN if given is None else given
        for given in ((plan.tilt, plan.swivel) if plan is not None else (None, None))
    )
    names = model.coordinate_names
    out = np.zeros((count, len(names)))
    if "plate.rx" in names:
        axis = rng.uniform(0.0, 2 * np.pi, count)
        leaning = np.zeros((count, 3))
        size = tilt * np.sqrt(rng.uniform(0.0, 1.0, count))
        leaning[:, 0], leaning[:, 1] = size * np.cos(axis), size * np.sin(axis)
        about_z = np.zeros((count, 3))
        about_z[:, 2] = swivel * rng.uniform(-1.0, 1.0, count)
        out[:, :3] = logarithm(exponential(leaning) @ exponential(about_z))
    if "plate.x" in names:
        size_m = max(
            abs(getattr(point, axis).nominal) for point in mechanism.base_points for axis in "xyz"
        )
        out[:, -3:] = 0.2 * size_m * rng.uniform(-1.0, 1.0, (count, 3))
    return out
