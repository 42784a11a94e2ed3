"""Where nature's randomness comes from: one generator a purpose, all from one seed.

Streams of their own keep what is drawn apart: hiding an effect does not change the geometry
that is drawn, more samples do not change the poses.
"""

from __future__ import annotations

import numpy as np

PARAMETERS = 1
EFFECTS = 2
ASSEMBLY = 3
HAND = 4
NOISE = 5
ARRIVAL = 6
SESSION = 7
VISITS = 8


def stream(seed: int, purpose: int, number: int = 0) -> np.random.Generator:
    """The generator of ``purpose`` (of its ``number``-th channel, device, ...) under ``seed`` >= 0."""
    return np.random.default_rng([seed, purpose, number])
