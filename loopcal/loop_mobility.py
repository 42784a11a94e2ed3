"""How a rig's closed loop can move: what a capture session must know of its kinematics.

The session refuses to hold more joints than the loop has freedoms (`daq.mobility`). It knows no
kinematics itself; the solver's model of the nominal rig answers, at configurations all over
what the joints can reach.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.mobility import Mobility
from recordings.rig import PlatformMechanism, Rig, parameters
from solver.mechanism.model import Model, mechanism_model
from solver.poses.wander import wander

_CONFIGURATIONS = 20
_RANK = 1e-6
"""Of the largest singular value, as `Model.mobility` counts freedoms."""


def mobility_of(rig: Rig) -> Mobility:
    """The motions that the nominal mechanism of ``rig`` allows; raises MechanismError where it does not close."""
    table = parameters(rig)
    model = mechanism_model(rig, table)
    nominal = np.array([parameter.nominal for parameter in table])
    poses = wander(rig, model, nominal, _CONFIGURATIONS, seed=0)
    places = rig.mechanism.places
    if isinstance(rig.mechanism, PlatformMechanism):
        motions = _of_legs(rig, model, poses, nominal)
        return Mobility(motions.shape[2], tuple(c.senses for c in rig.channels), motions)
    freedoms = model.mobility(poses, nominal)
    closure = model.linearise(poses, nominal, np.zeros((len(nominal), 0))).closure_by_coordinates
    # Rows of V' behind the rank of the closure span the motions that keep it closed.
    _, _, right = np.linalg.svd(closure)
    motions = np.swapaxes(right[:, right.shape[1] - freedoms :], 1, 2)
    rows = [model.coordinate_names.index(place) for place in places]
    return Mobility(freedoms, places, motions[:, rows])


def _of_legs(
    rig: Rig, model: Model, poses: NDArray[np.float64], nominal: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(P, channels, m) rates of what each channel senses [rad or m] with the plate's freedoms, unit columns."""
    rates = model.linearise(poses, nominal, np.zeros((len(nominal), 0))).readings_by_coordinates
    gains = np.array([channel.gain.nominal for channel in rig.channels])
    motions = rates * gains[:, None]
    sizes = np.linalg.norm(motions, axis=1, keepdims=True)
    return np.asarray(motions / np.maximum(sizes, _RANK))
