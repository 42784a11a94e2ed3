"""How far a wrong parameter puts the endpoint or the plate from where the readings say it is.

In the spirit of Nahvi, Hollerbach & Hayward, section 4.1.2 d and Figure 3, where the error of
the end plate under 1 mm of error in each parameter helps to decide what to calibrate. The
readings stay; the calibrated pose that is computed from them changes with the parameter: by
forward kinematics where all joints between base and end are sensed, and with the most likely
coordinates following where they are not. First order, one parameter at a time: what two of them
undo of each other is the business of `estimate.null_directions`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, parameters
from solver.effects.needs import generic
from solver.estimate.nuisance import Observations, assemble, settle
from solver.estimate.null_directions import step_of
from solver.forward import forward, sensed_all_the_way
from solver.mechanism.model import Model, model_of
from solver.mechanism.space import ParameterSpace
from solver.mechanism.tracker import Tracked
from solver.poses.wander import wander

Array = NDArray[np.float64]

_POSES = 200
_LEAST_NOISE = 0.3  # counts: of a channel that states less


@dataclass(frozen=True)
class Sensitivity:
    """Motion of the endpoint or plate with each of n parameters, over some poses.

    Attributes:
        space: the parameters, as its identified ones.
        errors: (n,) plausible error of each, SI: its stated uncertainty, else one ``step``.
        stated: (n,) whether the rig states that uncertainty.
        steps: the unit of each in which "per unit" counts, and its size in SI: 1 mm, 1 deg, or
            1 % of a gain.
        displacement_rms, displacement_max: (n,) [m] at that error, over the poses.
        rotation_rms, rotation_max: (n,) [rad], likewise; the angle of the small rotation.
        poses: how many.
    """

    space: ParameterSpace
    errors: Array
    stated: NDArray[np.bool_]
    steps: tuple[tuple[str, float], ...]
    displacement_rms: Array
    displacement_max: Array
    rotation_rms: Array
    rotation_max: Array
    poses: int

    @property
    def per_unit(self) -> Array:
        """(n,) what the figures at the plausible error are multiplied by for one unit."""
        return np.array([size for _, size in self.steps]) / self.errors

    @property
    def shifts(self) -> bool:
        """Whether any of the parameters shifts the endpoint or plate; none shifts a pivoted plate."""
        return bool(self.displacement_rms.max(initial=0.0) > 0.0)

    @property
    def turns(self) -> bool:
        """Whether any of the parameters turns it."""
        return bool(self.rotation_rms.max(initial=0.0) > 0.0)


def sensitivity(
    model: Model, space: ParameterSpace, at: Array, observed: Observations, coordinates: Array
) -> Sensitivity:
    """Sensitivity over given poses.

    Args:
        model: the mechanism and its sensors; a tracker that watches it takes no part.
        space: whose identified parameters are asked about.
        at: (N,) parameters, SI.
        observed: readings of P poses.
        coordinates: (P, U) the poses, settled or near to it.
    """
    if isinstance(model, Tracked):
        own = model.own
        seen = Observations(observed.counts[:, own], observed.sigma[:, own], observed.at)
        return sensitivity(model.inner, space, at, seen, coordinates)
    rates = _end_rates(model, space, at, observed, coordinates)
    steps = tuple(step_of(space.table[i], float(at[i])) for i in space.identified)
    stated = np.isfinite(space.uncertainty) & (space.uncertainty > 0)
    errors = np.where(stated, space.uncertainty, [size for _, size in steps])
    moved = np.linalg.norm(rates[:, :3] * errors, axis=1)
    turned = np.linalg.norm(rates[:, 3:] * errors, axis=1)
    return Sensitivity(
        space,
        errors,
        stated,
        steps,
        displacement_rms=np.sqrt(np.mean(moved**2, axis=0)),
        displacement_max=moved.max(axis=0),
        rotation_rms=np.sqrt(np.mean(turned**2, axis=0)),
        rotation_max=turned.max(axis=0),
        poses=len(coordinates),
    )


def generic_sensitivity(rig: Rig, values: Array | None = None) -> Sensitivity:
    """Sensitivity to every parameter of ``rig`` that follows no other, over poses spread over its reach.

    Args:
        rig: the description.
        values: (N,) parameters from an earlier calibration, SI; nominal by default.

    Raises:
        MechanismError: the mechanism cannot be assembled.
    """
    model, table = model_of(rig), parameters(rig)
    space = ParameterSpace.of(table, [p.name for p in table if p.tie is None])
    x = space.nominal if values is None else values
    coordinates = wander(rig, model, x, _POSES, seed=0)
    at = generic(rig, model, coordinates, x)
    counts = model.linearise(coordinates, x, space.expansion[:, :0], at).readings
    noise = [max(channel.noise, _LEAST_NOISE) for channel in rig.channels]
    return sensitivity(
        model, space, x, Observations(counts, np.tile(noise, (_POSES, 1)), at), coordinates
    )


def _end_rates(
    model: Model, space: ParameterSpace, at: Array, observed: Observations, coordinates: Array
) -> Array:
    """(P, 6, n) rates of [dp; domega] in the base frame with the identified parameters, readings held."""
    if sensed_all_the_way(model):
        return forward(model, observed, at, space.expansion).end.by_parameters
    settled = settle(model, observed, coordinates, at, space.expansion)
    if not settled.closed.all():
        start = assemble(model, observed, at)
        settled = settle(model, observed, start, at, space.expansion)
    end = model.end_pose(settled.coordinates, at, space.expansion, observed.at)
    return np.asarray(end.by_parameters + end.by_coordinates @ settled.following)
