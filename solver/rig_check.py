"""What can be said of a rig before hardware is touched: mobility, redundancy, rank, likely mistakes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, SerialMechanism, parameters
from solver.coincidence import coaxial_joints, coincident_fixtures
from solver.effects.needs import generic
from solver.errors import MechanismError
from solver.estimate.identifiability import Identifiability, identifiability
from solver.estimate.nuisance import Observations, settle
from solver.estimate.null_directions import point_frames
from solver.mechanism.model import Model, model_of
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.mobility import immobile, offset_determined, told
from solver.poses.wander import assembled, limits, wander

Array = NDArray[np.float64]

_SAMPLED = 60
_NEAR_SINGULAR = 0.01


@dataclass(frozen=True)
class RigCheck:
    """The findings about one rig.

    Attributes:
        mobility: freedoms of the closed mechanism.
        redundancy: equations that each pose gives.
        sensed: place -> channel.
        unsensed: coordinates that no channel senses.
        identified: names of the parameters to identify.
        identifiability: what generic poses would determine, or None where it does not close.
        mistakes: what will not work.
        remarks: what may not be meant.
    """

    mobility: int
    redundancy: int
    sensed: dict[str, str]
    unsensed: tuple[str, ...]
    identified: tuple[str, ...]
    identifiability: Identifiability | None
    mistakes: tuple[str, ...]
    remarks: tuple[str, ...]


def check_rig(rig: Rig) -> RigCheck:
    """Examine ``rig`` without any measurement."""
    model = model_of(rig)
    space = ParameterSpace.of(parameters(rig))
    sensed = {channel.senses: channel.name for channel in rig.channels}
    unsensed = tuple(name for name in _coordinates(rig, model) if name not in sensed)
    mistakes: list[str] = []
    remarks: list[str] = []
    if not space.names:
        mistakes.append("nothing is identified: set identify = true on the parameters to estimate")
    for twice in (*coaxial_joints(rig), *coincident_fixtures(rig)):
        (mistakes if twice.sure or twice.contradicted else remarks).append(twice.text)
    try:
        home = assembled(rig, model, space.nominal)
    except MechanismError as error:
        return RigCheck(
            0, 0, sensed, unsensed, space.names, None, (*mistakes, str(error)), tuple(remarks)
        )
    poses = wander(rig, model, space.nominal, _SAMPLED, seed=0)
    mobility = model.mobility(poses, space.nominal)
    redundancy = len(rig.channels) - mobility
    if redundancy <= 0:
        mistakes.append(
            f"{len(rig.channels)} sensed coordinates for a mobility of {mobility} leave no equation to calibrate from; "
            "sense more, or free less"
        )
    low, high = limits(rig, model)
    for name, value, lowest, highest in zip(model.coordinate_names, home, low, high, strict=True):
        if not lowest <= value <= highest:
            mistakes.append(f"at home, {name} is at {_shown(value)}, outside its limits")
    mistakes += _plan_mistakes(rig, model, space.nominal, mobility, poses)
    mistakes += _range_mistakes(rig, model, space.nominal, poses)
    remarks += [
        f"channel '{c.name}' has no device: it can be solved, not captured"
        for c in rig.channels
        if c.device is None
    ]
    sigma = np.array([max(channel.noise, 0.3) for channel in rig.channels])
    around = generic(rig, model, poses, space.nominal)
    at = model.linearise(poses, space.nominal, space.expansion, around)
    observed = Observations(at.readings, np.tile(sigma, (len(poses), 1)), around)
    settled = settle(model, observed, poses, space.nominal, space.expansion)
    firm = np.isfinite(settled.jacobian).all(axis=(1, 2))
    if not firm.all():
        mistakes.append(
            f"{np.sum(~firm)} of {len(poses)} configurations around home are singular: axes coincide, or links are in "
            "one line, so that joints turn against each other without effect. Choose another home or fixture"
        )
    found = identifiability(
        space,
        settled.jacobian[firm].reshape(-1, len(space.names)),
        space.nominal,
        point_frames(rig),
    )
    if isinstance(model, SerialModel) and mobility == 0:
        mistakes.append(
            "the closed mechanism cannot move at all: every pose would be the same. Free more of the "
            "endpoint, or check that no axis or fixture is given twice"
        )
    elif isinstance(model, SerialModel):
        for j in immobile(model, space.nominal, poses):
            name = model.coordinate_names[j]
            determined = offset_determined(space, found.held, name, sensed.get(name))
            remarks.append(told(name, determined=determined))
    remarks += [f"generic poses do not determine: {words}" for words in found.combinations]
    return RigCheck(
        mobility, redundancy, sensed, unsensed, space.names, found, tuple(mistakes), tuple(remarks)
    )


def _coordinates(rig: Rig, model: Model) -> tuple[str, ...]:
    return (
        model.coordinate_names
        if isinstance(rig.mechanism, SerialMechanism)
        else rig.mechanism.places
    )


def _shown(value: float) -> str:
    return f"{value:.4g} (SI; {np.rad2deg(value):.1f} deg if an angle)"


def _plan_mistakes(rig: Rig, model: Model, x: Array, mobility: int, poses: Array) -> list[str]:
    """A driven plan must hold exactly as many joints as there are freedoms, and those must fix the pose."""
    if rig.plan is None or rig.plan.mode != "driven":
        return []
    drives = [model.coordinate_names.index(name) for name in rig.plan.drives]
    if len(drives) != mobility:
        verb = (
            "leaves the pose undetermined"
            if len(drives) < mobility
            else "makes the drives fight each other"
        )
        return [
            f"the plan drives {len(drives)} joints of a mechanism of mobility {mobility}, which {verb}"
        ]
    jacobian = model.linearise(poses, x, np.zeros((len(x), 0))).closure_by_coordinates
    following = np.delete(jacobian, drives, axis=2)
    smallest = np.linalg.svd(following, compute_uv=False)[:, -1]
    if np.median(smallest) < _NEAR_SINGULAR:
        return [
            f"holding {', '.join(rig.plan.drives)} does not fix the pose: the other joints can still move"
        ]
    return []


def _range_mistakes(rig: Rig, model: Model, x: Array, poses: Array) -> list[str]:
    """Channels whose counts cannot hold most of the travel: a wrong gain, zero or count range."""
    counts = model.linearise(poses, x, np.zeros((len(x), 0))).readings
    out = []
    for c, channel in enumerate(rig.channels):
        if channel.count_range is None or channel.modulus_counts is not None:
            continue
        low, high = channel.count_range
        outside = float(np.mean((counts[:, c] < low) | (counts[:, c] > high)))
        if outside > 0.5:
            out.append(
                f"channel '{channel.name}' would read {counts[:, c].min():.0f} to {counts[:, c].max():.0f} counts over the "
                f"workspace, its range is {low} to {high}; check gain, offset and zero_count"
            )
    return out
