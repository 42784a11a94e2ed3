"""What raw codes tell before any fit: bits that never toggle, and rails that counts stop at.

A converter's defects leave traces in its codes that no closure residual shows: a stuck bit below
the noise, a rail that bends every parameter of a fit that does not know of it. So they are
looked for first, in all readings, in motion and at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.reader import Recording
from recordings.rig import DescribedEffect, Quantity
from solver.samples import PoseTable

_CODES = 64  # readings on either side of where a bit would toggle, at the least
_NOISY, _SILENT = 0.6, 0.01  # counts
_POSES = 3  # distinct poses at a rail, at the least
_HEAPED = 5.0  # times as many readings as the codes next to it
_NEIGHBOURS = 3
_HIDDEN = 8.0  # standard deviations of one sample
_NEAR = 4.0  # standard deviations of one sample

CENSORED = 3e3
"""By how much a reading that says nothing has its standard deviation multiplied."""


def defects(recording: Recording, table: PoseTable) -> tuple[DescribedEffect, ...]:
    """Stuck bits and rails of the converters of ``recording``, as effects, in rig order."""
    found: list[DescribedEffect] = []
    for c, channel in enumerate(recording.rig.channels):
        if channel.count_range is None or channel.modulus_counts is not None:
            continue
        raw = recording.readings[channel.name].raw
        width = max(abs(end) for end in channel.count_range).bit_length()
        for bit, value in _stuck(raw, width).items():
            settings = {
                "bit": Quantity(float(bit), "ratio"),
                "value": Quantity(float(value), "ratio"),
            }
            found.append(DescribedEffect("stuck-bit", channel.name, settings))
        ends = {
            side: Quantity(float(end), "count", None, identify=True)
            for side, end in _rails(raw, table.counts[:, c], float(table.noise[c]), table).items()
        }
        if ends:
            found.append(DescribedEffect("saturation", channel.name, ends))
    return tuple(found)


def censored(
    sigma: NDArray[np.float64], table: PoseTable, found: Sequence[DescribedEffect]
) -> NDArray[np.float64]:
    """``sigma`` (P, C) with those readings made worthless that the defects ``found`` made so.

    A reading at a rail says only that the channel is beyond it; one whose samples fall on both
    sides of where a stuck bit should toggle is a mixture of two codes.
    """
    out = sigma.copy()
    for effect in found:
        c = table.channels.index(effect.where)
        counts, noise = table.counts[:, c], float(np.median(table.noise[c]))
        near = _NEAR * max(noise, 0.5)
        if effect.name == "saturation":
            ends = [(side, value.nominal) for side, value in effect.values.items()]
            for side, end in ends:
                out[(counts - end if side == "low" else end - counts) < near, c] *= CENSORED
        if effect.name == "stuck-bit":
            weight = 2.0 ** effect.values["bit"].nominal
            if weight < _HIDDEN * max(noise, 0.5):
                continue  # noise mixes both codes at every pose, and the model says in what shares
            past = np.mod(counts + 0.5, weight)
            out[np.minimum(past, weight - past) < min(near, 0.25 * weight), c] *= CENSORED
    return out


def _stuck(raw: NDArray[np.int64], width: int) -> Mapping[int, int]:
    """By bit, the value that it never leaves although the higher bits and the travel say it should."""
    out = {}
    for bit in range(width):
        ones = (raw >> bit) & 1
        value = int(ones[0]) if len(ones) else 0
        if not len(ones) or np.any(ones != value):
            continue
        # A healthy bit toggles with every step of its weight: codes that span several such steps
        # must have met both values.
        higher = raw >> (bit + 1)
        if len(np.unique(higher)) >= 3 and len(raw) >= 2 * _CODES:
            out[bit] = value
    return out


def _rails(
    raw: NDArray[np.int64], counts: NDArray[np.float64], noise: float, table: PoseTable
) -> Mapping[str, int]:
    """By side, "low" and "high", the code that readings heap up at.

    One dwell is enough where a channel that is noisy elsewhere shows no noise at all.
    """
    out: dict[str, int] = {}
    codes, number = np.unique(raw, return_counts=True)
    if len(codes) < 2 * _NEIGHBOURS:
        return out
    poses = np.array([w.pose for w in table.windows])
    for side, last, inner in (
        ("low", 0, slice(1, 1 + _NEIGHBOURS)),
        ("high", -1, slice(-1 - _NEIGHBOURS, -1)),
    ):
        heaped = number[last] > _HEAPED * (1.0 + float(number[inner].mean()))
        at = np.abs(counts - codes[last]) < 0.5
        silent = noise > _NOISY and bool(np.any(np.abs(counts - codes[last]) < _SILENT))
        if heaped and (silent or len(np.unique(poses[at])) >= _POSES):
            out[side] = int(codes[last])
    return out
