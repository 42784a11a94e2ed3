"""Which parameters of a rig to identify: starting from all, the least observable one is held, step by step.

In the spirit of Nahvi, Hollerbach & Hayward, section 4.1.2. Generic poses stand for a session.
Each step records the indices of the whitened Jacobian in units of plausible errors, and holds
the parameter that weighs most in its least determined direction; parameters that follow a
tie stay tied. It stops when the least determined direction is known to better than a tenth
of a plausible error and the condition number is within the stated limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recordings.rig import Rig, parameters
from solver.errors import MechanismError
from solver.estimate.identifiability import plausible_error
from solver.estimate.nuisance import Observations, settle
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.observability import observability
from solver.poses.wander import wander

SURE = 10.0
"""Standard errors that a plausible error must be worth, in every direction."""
ACCEPTABLE = 1000.0
"""Largest condition number, which the paper found acceptable for the shoulder."""
_POSES = 60


@dataclass(frozen=True, slots=True)
class Step:
    """Indices with some parameters free.

    Attributes:
        free: how many.
        sigma_min: smallest singular value, 1 / the standard error of the least determined
            direction in plausible errors (equation 12).
        product: equation 13.
        condition: equation 14.
        held: parameter that is held next, or None where these will do.
    """

    free: int
    sigma_min: float
    product: float
    condition: float
    held: str | None


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """The steps, and the names of the parameters that remain, in rig order."""

    steps: tuple[Step, ...]
    chosen: tuple[str, ...]


def choose_parameters(rig: Rig, *, condition: float = ACCEPTABLE) -> ParameterChoice:
    """A well-posed set of parameters for ``rig``, whatever it asks to identify.

    Args:
        rig: the description.
        condition: largest condition number to accept.

    Raises:
        MechanismError: the mechanism cannot be assembled, or nothing can be identified.
    """
    model, table = model_of(rig), parameters(rig)
    names = [p.name for p in table if p.tie is None]
    space = ParameterSpace.of(table, names)
    x = space.nominal
    poses = wander(rig, model, x, _POSES, seed=1)
    readings = model.linearise(poses, x, space.expansion).readings
    sigma = np.tile([max(channel.noise, 0.3) for channel in rig.channels], (_POSES, 1))
    settled = settle(model, Observations(readings, sigma), poses, x, space.expansion)
    whitened = settled.jacobian.reshape(-1, len(names)) * plausible_error(space)
    steps: list[Step] = []
    while names:
        indices = observability(whitened, scaled=False)
        good = indices.sigma_min >= SURE and indices.condition <= condition
        worst = 0
        if not good:
            # Of null directions none is the least: what they move together is what counts.
            _, singular, right = np.linalg.svd(np.linalg.qr(whitened, mode="r"))
            weak = right[singular <= max(1.0, singular[-1])]
            worst = int(np.argmax(np.linalg.norm(weak, axis=0)))
        steps.append(
            Step(
                len(names),
                indices.sigma_min,
                indices.product,
                indices.condition,
                None if good else names[worst],
            )
        )
        if good:
            return ParameterChoice(tuple(steps), tuple(names))
        names.pop(worst)
        whitened = np.delete(whitened, worst, axis=1)
    raise MechanismError(
        f"no parameter of rig '{rig.name}' can be identified from its own sensors; sense more, or free less"
    )
