"""What a mechanism at rest carries, pose by pose. Owns the table; `solver.mechanism.statics` fills it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Loads:
    """Loads at P poses; None where they are not determined, which ``why`` then says.

    Attributes:
        torque: (P, J) what each joint's drive exerts on its link, along the joint [Nm or N]; of a
            platform the tension of each leg [N].
        force: (P, 3) what the mechanism exerts on its fixture, in the fixture's axes (the base
            frame's where there is none); of a pivoted platform, on its pivot [N].
        moment: (P, J, 2) what holds each turning joint across its axis, about the axes of its tilts
            [Nm]; 0 of a slide. None of a platform.
        why: in words for the user; empty where all is known.
    """

    torque: Array | None
    force: Array | None
    moment: Array | None = None
    why: str = ""
