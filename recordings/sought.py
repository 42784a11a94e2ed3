"""Which coordinates of a fixture's place are worth seeking, where the tip is free to move along or about its axes.

A freedom of the closure takes one coordinate's worth of the fixture's place away: along or
about that axis the fixture may lie anywhere. Its axes are its own, its coordinates those of
the base frame (`recordings.rig.mechanism.POSE`), so that what is held is the coordinate that
comes nearest to moving the fixture in its freedom.
"""

from __future__ import annotations

from collections.abc import Set
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def sought(rotation: Array, freedoms: Set[str]) -> tuple[str, ...]:
    """Coordinates of a fixture that reach every change of place that its freedoms do not undo.

    Args:
        rotation: (3, 3), base from fixture.
        freedoms: of the tip along and about the fixture's axes, of x, y, z, rx, ry, rz.
    """
    by_shifts = rotation.T  # along the fixture's axes, by x, y, z
    rx, ry = np.arctan2(rotation[2, 1], rotation[2, 2]), -np.arcsin(np.clip(rotation[2, 0], -1, 1))
    # About the fixture's axes, by rx, ry, rz of Rz Ry Rx.
    by_turns = np.array(
        [
            [1.0, 0.0, -np.sin(ry)],
            [0.0, np.cos(rx), np.sin(rx) * np.cos(ry)],
            [0.0, -np.sin(rx), np.cos(rx) * np.cos(ry)],
        ]
    )
    parts = (("xyz", by_shifts), (("rx", "ry", "rz"), by_turns))
    return tuple(name for names, rates in parts for name in _chosen(tuple(names), rates, freedoms))


def _chosen(names: tuple[str, ...], rates: Array, freedoms: Set[str]) -> tuple[str, ...]:
    """As many of three ``names`` as are not free, those that best span what is not."""
    held = [axis for axis, name in enumerate(names) if name not in freedoms]
    sets = list(combinations(range(3), len(held)))
    # Where several do as well, the one that keeps the names of the freedoms out.
    sets.sort(key=lambda some: sum(names[i] in freedoms for i in some))
    spans = [abs(float(np.linalg.det(rates[np.ix_(held, some)]))) for some in sets]
    return tuple(names[i] for i in sets[int(np.argmax(np.round(spans, 6)))])


def with_level_x(rotation: Array) -> Array:
    """``rotation`` (3, 3) turned about its own z until its x lies level: then its ry is 0."""
    turn = np.arctan2(-rotation[2, 0], rotation[2, 1])
    turn -= np.pi * np.round(turn / np.pi)
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(rotation @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
