"""Whether something is missing that has no name: smooth patterns that no known effect would leave.

Each channel's reading is tested against smooth functions of where the mechanism stands (low
powers of the principal coordinates of its poses), of time (slow courses, and swings of any one
period), and against the moves that brought it there. A pattern that stands out after all named
effects is none of the known ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.polynomial import legendre

from solver.estimate.nuisance import eliminated
from solver.gap.channels import checked, moved
from solver.gap.fit import Fit
from solver.gap.score import Array, log_f_tail
from solver.mechanism.model import Linearised

_POWER = 3
_TIMES = 5  # orders of the course over time
_SWINGS = 20  # half periods in a session, at the most
_MOVES = 2  # before a dwell, of which it may remember something
_DRAWS = 400
_SPREAD = 1e-3  # of the largest principal coordinate: less is no freedom of its own


@dataclass(frozen=True)
class Pattern:
    """One group of smooth functions at one channel.

    Attributes:
        channel: what would see it.
        over: what it goes with: "pose", "time", "swing" or "move".
        number: of the group, among those of the channel.
        log_p: by itself.
        explained: chi-square that it would take away, in units of the noise that is left.
    """

    channel: str
    over: str
    number: int
    log_p: float
    explained: float


@dataclass(frozen=True)
class Followed:
    """A pattern as the channel would have to see it, at P poses.

    Attributes:
        along: (P,) time [s] of a course or a swing, or how far the channel went in the move before [rad or m].
        seen: (P,) beyond its true value [rad or m].
        beside: (P,) what the channel disagrees with the rest of the loop besides [rad or m]; NaN where the rest
            says nothing.
    """

    along: Array
    seen: Array
    beside: Array


@dataclass(frozen=True)
class Unknown:
    """The patterns, most significant first, and the family-wise p-value of the first."""

    patterns: tuple[Pattern, ...]
    p: float

    def strangest(self, most: int) -> tuple[Pattern, ...]:
        """The first of each kind at each channel."""
        kinds: dict[tuple[str, str], Pattern] = {}
        for pattern in self.patterns:
            kinds.setdefault((pattern.channel, pattern.over), pattern)
        return tuple(kinds.values())[:most]


def unknown(fit: Fit, rng: np.random.Generator) -> Unknown:
    """Patterns in the residual of ``fit`` that nothing in it explains."""
    names, bases = _groups(fit)
    if not bases:
        return Unknown((), 1.0)
    drawn = np.hstack([fit.projected(fit.stacked[:, None]), fit.drawn(_DRAWS, rng)])
    total = np.sum(drawn**2, axis=0)
    statistic = np.array([np.sum((basis.T @ drawn) ** 2, axis=0) for basis in bases])
    width = np.array([basis.shape[1] for basis in bases])
    log_p = log_f_tail(statistic, width[:, None], total, fit.freedoms)
    noise = (total[0] - statistic[:, 0]) / np.maximum(fit.freedoms - width, 1)
    lowest = log_p.min(axis=0)
    p = (1.0 + float(np.sum(lowest[1:] <= lowest[0]))) / (1.0 + _DRAWS)
    order = np.argsort(log_p[:, 0])
    return Unknown(
        tuple(
            Pattern(
                names[i][0],
                names[i][1],
                names[i][2],
                float(log_p[i, 0]),
                float(statistic[i, 0] / noise[i]),
            )
            for i in order
        ),
        p,
    )


def followed(fit: Fit, pattern: Pattern) -> Followed | None:
    """``pattern`` fitted to the residual of ``fit``, where it was found; None over the pose, which is no line."""
    if pattern.over == "pose" or fit.at.time_s is None:
        return None
    c = fit.model.channels.index(pattern.channel)
    shapes = [*_shapes(fit), *_moves(fit, c)][pattern.number][1]
    trace = _trace(fit, _here(fit), c, shapes)
    left = fit.projected(fit.stacked[:, None])[:, 0]
    size = np.linalg.lstsq(trace, left, rcond=1e-6)[0]
    gain = float(fit.parameters[fit.model.sensing.gain[c]])
    # A pattern is smooth in units of each dwell's own noise; shown is the smooth course for dwells alike.
    noise = fit.observed.sigma[:, c]
    seen = gain * float(np.median(noise)) * (shapes @ size)
    rest = (left - trace @ size)[: fit.residual.size].reshape(fit.residual.shape)[:, c]
    beside = gain * noise * (shapes @ size + rest / checked(fit)[:, c]) - seen
    along = _went(fit, c)[:, 0] if pattern.over == "move" else fit.at.time_s
    return Followed(along, seen, beside)


def _groups(fit: Fit) -> tuple[list[tuple[str, str, int]], list[Array]]:
    """Channel, kind and number, and orthonormal bases (P C, k) of the groups, projected off what parameters absorb."""
    here = _here(fit)
    poses = len(fit.residual)
    everywhere = _shapes(fit)
    names, bases = [], []
    for c, channel in enumerate(fit.model.channels):
        for number, (over, shapes) in enumerate((*everywhere, *_moves(fit, c))):
            trace = _trace(fit, here, c, shapes)
            left, singular, _ = np.linalg.svd(trace, full_matrices=False)
            basis = left[:, singular > 1e-4 * np.sqrt(poses)]
            if basis.shape[1] and basis.shape[1] < fit.freedoms // 2:
                names.append((channel, over, number))
                bases.append(basis)
    return names, bases


def _here(fit: Fit) -> Linearised:
    nowhere = np.zeros((len(fit.parameters), 0))
    return fit.model.linearise(fit.settled.coordinates, fit.parameters, nowhere, fit.observed.at)


def _trace(fit: Fit, here: Linearised, channel: int, shapes: Array) -> Array:
    """(P C, k) what parameters leave of ``shapes`` (P, k), seen by a channel in units of its noise."""
    poses, channels = here.readings.shape
    by = np.zeros((poses, channels, shapes.shape[1]))
    by[:, channel] = shapes * fit.observed.sigma[:, channel, None]
    nowhere = np.zeros((poses, here.closure.shape[1], shapes.shape[1]))
    changed = eliminated(here, fit.observed, by, nowhere)[0]
    return fit.projected(-changed.reshape(poses * channels, -1))


def _shapes(fit: Fit) -> list[tuple[str, Array]]:
    """Smooth functions (P, k) of the poses' circumstances, each of unit mean square."""
    values = fit.values
    scaled = ((values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-300))[
        :, moved(fit)
    ]
    out = []
    if scaled.shape[1]:
        left, singular, _ = np.linalg.svd(scaled, full_matrices=False)
        freedoms = max(values.shape[1] - fit.redundancy, 1)
        kept = left[:, : min(freedoms, int(np.sum(singular > _SPREAD * singular[0])))]
        principal = kept * np.sqrt(len(values))
        terms = [
            np.prod(principal[:, list(chosen)], axis=1)
            for power in range(1, _POWER + 1)
            for chosen in combinations_with_replacement(range(principal.shape[1]), power)
        ]
        out.append(("pose", np.stack(terms, axis=1)))
    at = fit.at
    if at.time_s is not None and np.ptp(at.time_s) > 0:
        x = (at.time_s - at.time_s.min()) / np.ptp(at.time_s)
        slow = legendre.legvander(2.0 * x - 1.0, _TIMES)[:, 1:]
        out.append(("time", np.asarray(slow, dtype=np.float64)))
        turns = np.pi * x[:, None] * np.arange(_TIMES, _SWINGS + 1)
        out += [("swing", np.stack([np.cos(t), np.sin(t)], axis=1)) for t in turns.T]
    return [(over, _unit(shapes)) for over, shapes in out]


def _moves(fit: Fit, channel: int) -> list[tuple[str, Array]]:
    """`_went`, of unit mean square; nothing where nobody knows the order, or the channel did not move."""
    time_s = fit.at.time_s
    if time_s is None or not np.ptp(time_s) > 0 or not moved(fit)[channel]:
        return []
    return [("move", _unit(_went(fit, channel)))]


def _went(fit: Fit, channel: int) -> Array:
    """(P, k) how far ``channel`` went in the last moves before each dwell [rad or m], the last one first."""
    assert fit.at.time_s is not None  # callers look first
    order = np.argsort(fit.at.time_s, kind="stable")
    value = fit.values[order, channel]
    went = np.zeros((len(value), _MOVES))
    for k in range(_MOVES):
        went[k + 1 :, k] = value[1 : len(value) - k] - value[: len(value) - k - 1]
    back = np.empty_like(went)
    back[order] = went
    return back


def _unit(shapes: Array) -> Array:
    return np.asarray(shapes / np.maximum(np.sqrt(np.mean(shapes**2, axis=0)), 1e-300))
