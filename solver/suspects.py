"""What single mistake in a rig would explain readings that do not fit: a unit, a sign, exchanged channels.

Tries each on a few poses at the nominal parameters, and names it only where it makes the
misfit many times smaller. Used when a solve has failed, to say where to look.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, parameters
from solver.estimate.nuisance import Observations, assemble, settle
from solver.mechanism.model import Model

Array = NDArray[np.float64]

_TRIED_ON = 10  # poses
_BETTER = 0.4  # of the residual may be left with the mistake undone,
_RUNNER_UP = 0.67  # of what the next best explanation leaves,
_CLEAR = 0.3  # and of the motion: shrinking all motion explains nothing

_FACTORS = {
    -1.0: "has the wrong sign",
    180.0 / np.pi: "is too small by 57.3: it looks like rad where deg was written, or the reverse",
    np.pi / 180.0: "is too large by 57.3: it looks like deg where rad was written, or the reverse",
    1000.0: "is too small by 1000: it looks like mm where m was written, or the reverse",
    0.001: "is too large by 1000: it looks like m where mm was written, or the reverse",
}


def suspects(rig: Rig, model: Model, observed: Observations, nominal: Array) -> tuple[str, ...]:
    """Sentences that name the mistake which would explain ``observed`` best; none where none does.

    Args:
        rig: as described.
        model: its mechanism.
        observed: averaged readings of P poses.
        nominal: (N,) parameters.
    """
    some = np.linspace(0, len(observed.counts) - 1, min(_TRIED_ON, len(observed.counts)))
    poses = np.unique(some.astype(np.intp))
    # Every coordinate counts alike: noise is not what such a mistake is compared with, but
    # the errors of nominal parameters, which are of one size in all.
    gain = np.array([abs(channel.gain.nominal) for channel in rig.channels])
    few = Observations(observed.counts[poses], np.tile(1e-3 / gain, (len(poses), 1)))
    before, _ = _unexplained(model, few, nominal)
    tried = sorted(
        (*_unexplained(model, other, x), text)
        for other, x, text in (
            *((other, nominal, text) for other, text in _misread(rig, few)),
            *((few, x, text) for x, text in _mismeasured(rig, nominal)),
        )
    )
    if len(tried) < 2:
        return ()
    (left, share, told), (following, _, _) = tried[:2]
    clear = left < _BETTER * before and left < _RUNNER_UP * following and share < _CLEAR
    return (told,) if clear else ()


def _unexplained(model: Model, observed: Observations, x: Array) -> tuple[float, float]:
    """Median whitened residual of a pose, and its share of the motion; infinite where nothing closes."""
    found = settle(
        model, observed, assemble(model, observed, x), x, np.zeros((len(x), 0)), iterations=20
    )
    size = np.linalg.norm(found.residual, axis=1)
    size = np.where(found.closed & np.isfinite(size), size, np.inf)
    moved = (observed.counts - observed.counts.mean(axis=0)) / observed.sigma
    middle = float(np.sort(size)[len(size) // 2])
    return middle, middle / max(float(np.median(np.linalg.norm(moved, axis=1))), 1e-300)


def _misread(rig: Rig, observed: Observations) -> Iterator[tuple[Observations, str]]:
    """Readings with one mistake undone, and what that mistake is."""
    zero = np.array([float(channel.zero_count) for channel in rig.channels])
    every = np.arange(len(rig.channels))
    for factor, what in _FACTORS.items():
        angles = factor in (180.0 / np.pi, np.pi / 180.0)
        for chosen in ([c] for c in every), [list(every)]:
            for group in chosen:
                kinds = {rig.mechanism.dimension_of(rig.channels[c].senses) for c in group}
                if factor != -1.0 and kinds != {"angle" if angles else "length"}:
                    continue
                counts = observed.counts.copy()
                # A gain that is wrong by a factor is the same as counts that are.
                counts[:, group] = zero[group] + factor * (counts[:, group] - zero[group])
                name = rig.channels[group[0]].name
                whose = f"The gain of {name}" if len(group) == 1 else "The gain of every channel"
                yield Observations(counts, observed.sigma), f"{whose} {what}; correct the rig file."
    for a in every:
        for b in every[a + 1 :]:
            first, second = rig.channels[a], rig.channels[b]
            if first.gain.nominal == second.gain.nominal:
                order = every.copy()
                order[[a, b]] = b, a
                swapped = Observations(observed.counts[:, order], observed.sigma[:, order])
                yield (
                    swapped,
                    f"Channels {first.name} and {second.name} look exchanged; check the wiring and 'senses'.",
                )


def _mismeasured(rig: Rig, nominal: Array) -> Iterator[tuple[Array, str]]:
    """Parameters with one mistake in a length undone, and what that mistake is."""
    table = parameters(rig)
    channels = {channel.name for channel in rig.channels}
    lengths = [
        k
        for k, p in enumerate(table)
        if p.dimension == "length" and nominal[k] != 0.0 and p.name.split(".")[0] not in channels
    ]
    # A parameter that follows another is wrong with it.
    each = [
        [k, *(f for f in lengths if (tie := table[f].tie) and tie.parameter == table[k].name)]
        for k in lengths
        if table[k].tie is None
    ]
    for factor, is_, looks in (
        (1000.0, "too small", "m where mm"),
        (0.001, "too large", "mm where m"),
    ):
        for group in (*each, lengths):
            x = nominal.copy()
            x[group] *= factor
            whose = "Every length" if group is lengths else table[group[0]].name
            yield (
                x,
                f"{whose} is {is_} by 1000: it looks like {looks} was meant; correct the rig file.",
            )
