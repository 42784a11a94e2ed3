"""Directions in parameter space that leave every reading as it is, in words a person can use.

Owns the choice of readable directions in a null space and their names. Which directions are
null is decided in `identifiability`. Three kinds of readable directions are looked for:

- sparse ones: for each parameter, the direction of least 1-norm that moves it by one plausible
  error (a linear program), which has zeros wherever the null space allows zeros;
- the common scale of all lengths and gains, where the mechanism measures nothing absolute;
- the scale of one plate point with its legs, where a pivoted plate is joined to nothing else by them;
- shifts and turns of a whole frame of points, where nothing says where that frame is.

Of these the simplest are taken that together span the null space (greedily, which is best
for any weighting because linear independence is a matroid).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Parameter, PlatformMechanism, Rig
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

_MEMBER = 0.02  # of the largest component, in plausible errors: less is not worth a word
_INSIDE = 1e-3  # sine of the angle by which a direction may leave the null space
_EQUAL = 1e-3  # relative difference of two changes that count as equal
_MOST_NAMED = 6
_FRAME_RANK = 2.5  # a frame or scale is simpler than any three parameters, not than two

_STEPS = {"length": ("mm", 1e-3), "angle": ("deg", np.pi / 180.0)}


@dataclass(frozen=True)
class NullDirection:
    """One direction that the data do not determine.

    Attributes:
        words: what it is, for a person.
        change: (n,) of the identified parameters, SI; its length means nothing.
        members: names of the parameters that it moves.
    """

    words: str
    change: Array
    members: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PointFrames:
    """Points of a rig that the readings may not tell from others.

    Attributes:
        points: by frame, the points that could be shifted or turned as a whole.
        joined: groups of points and leg channels, each of which could be scaled by itself.
    """

    points: Mapping[str, tuple[str, ...]]
    joined: tuple[tuple[str, ...], ...] = ()


def point_frames(rig: Rig) -> PointFrames:
    """The points of ``rig``; those that legs join stay in one group.

    Where the plate turns about the common origin of both frames, a leg from A to B has
    L^2 = |A|^2 + |B|^2 - 2 A.RB, which scales with A and B at any turn R: what no leg joins can have
    scales of its own.
    """
    mechanism = rig.mechanism
    if not isinstance(mechanism, PlatformMechanism):
        return PointFrames({})
    frames = {
        "base": tuple(point.name for point in mechanism.base_points),
        "plate": tuple(point.name for point in mechanism.plate_points),
    }
    if mechanism.plate != "pivoted":
        return PointFrames(frames)
    groups: list[tuple[str, ...]] = []
    for leg in mechanism.legs:
        channel = rig.sensed_by(leg.name)
        group: tuple[str, ...] = (leg.plate, leg.base, *([channel.name] if channel else []))
        for other in [g for g in groups if leg.base in g or leg.plate in g]:
            groups.remove(other)
            group = (*other, *(name for name in group if name not in other))
        groups.append(group)
    return PointFrames(frames, tuple(groups) if len(groups) > 1 else ())


def readable(
    space: ParameterSpace,
    null: Array,
    plausible: Array,
    at: Array,
    frames: PointFrames,
) -> tuple[NullDirection, ...]:
    """Readable directions that span the null space.

    Args:
        space: what is identified.
        null: (n, k) orthonormal basis, in plausible errors.
        plausible: (n,) the size of a plausible error of each parameter, SI.
        at: (N,) parameters at which the null space was found.
        frames: the points: see `point_frames`.
    """
    offered: list[tuple[float, float, Array, str | None]] = []
    for direction in _sparse(null):
        members = int(np.sum(_large(direction)))
        offered.append((members, float(np.abs(direction).sum()), direction, None))
    common = (*_scale(space, at), *_own_scales(space, at, frames.joined))
    for words, change in (*common, *_frame_motions(space, at, frames.points)):
        moved = change / plausible
        size = float(np.linalg.norm(moved))
        if np.linalg.norm(moved - null @ (null.T @ moved)) <= _INSIDE * size:
            offered.append((_FRAME_RANK, 0.0, moved / size, words))
    offered.sort(key=lambda candidate: candidate[:2])
    taken: list[NullDirection] = []
    spanned = np.zeros((len(null), 0))
    for _, _, direction, name in offered:
        new = direction - spanned @ (spanned.T @ direction)
        if len(taken) < null.shape[1] and np.linalg.norm(new) > 1e-3 * np.linalg.norm(direction):
            spanned = np.column_stack([spanned, new / np.linalg.norm(new)])
            large = np.flatnonzero(_large(direction) if name is None else np.abs(direction) > 1e-9)
            order = large[np.argsort(-np.abs(direction[large]), kind="stable")]
            change = direction * plausible
            words = _words(space, change, order, at) if name is None else name
            taken.append(NullDirection(words, change, tuple(space.names[i] for i in large)))
    return tuple(taken)


def _large(direction: Array) -> NDArray[np.bool_]:
    return np.asarray(np.abs(direction) > _MEMBER * np.abs(direction).max())


def _sparse(null: Array) -> Iterator[Array]:
    """For each parameter that the null space moves, the direction of least 1-norm that moves it."""
    count, size = null.shape
    moved = np.flatnonzero(np.linalg.norm(null, axis=1) > _MEMBER)
    if size < 2:
        yield from (null[:, 0] / null[i, 0] for i in moved[:1])
        return
    from scipy.optimize import linprog  # heavy to import: only where it is needed

    for i in moved:
        # Variables: weights c of the basis, and bounds t on |null @ c|.
        solved = linprog(
            np.concatenate([np.zeros(size), np.ones(count)]),
            A_ub=np.block([[null, -np.eye(count)], [-null, -np.eye(count)]]),
            b_ub=np.zeros(2 * count),
            A_eq=np.concatenate([null[i], np.zeros(count)])[None],
            b_eq=[1.0],
            bounds=[(None, None)] * size + [(0.0, None)] * count,
            method="highs",
        )
        if solved.x is not None:
            yield null @ solved.x[:size]


def common_scale(space: ParameterSpace, at: Array) -> Array | None:
    """(n,) change of the identified parameters that scales the whole mechanism at ``at`` (N,).

    None where some length or gain that is not zero is not identified: the scale is then known.
    """
    full = np.where([p.dimension in ("length", "length/count") for p in space.table], at, 0.0)
    change = space.reduce(full)
    if not change.any() or np.abs(space.expansion @ change - full).max() > 1e-12:
        return None
    return change


def _scale(space: ParameterSpace, at: Array) -> Iterator[tuple[str, Array]]:
    change = common_scale(space, at)
    if change is not None:
        kinds = {space.table[i].dimension for i in space.identified}
        gains = " and gains" if "length/count" in kinds else ""
        yield f"the common scale of all lengths{gains}", change


def _own_scales(
    space: ParameterSpace, at: Array, joined: Sequence[Sequence[str]]
) -> Iterator[tuple[str, Array]]:
    """For each group of points and channels its scale, where all of it can follow."""
    for group in joined:
        full = np.array(
            [
                value if p.dimension in ("length", "length/count") else 0.0
                for p, value in zip(space.table, at, strict=True)
            ]
        )
        full[[p.name.rpartition(".")[0] not in group for p in space.table]] = 0.0
        change = space.reduce(full)
        if change.any() and np.abs(space.expansion @ change - full).max() <= 1e-12:
            yield f"the scale of {group[0]} with its legs alone ({', '.join(group[1:])})", change


def _frame_motions(
    space: ParameterSpace, at: Array, frames: Mapping[str, Sequence[str]]
) -> Iterator[tuple[str, Array]]:
    """Shifts and turns of all points of a frame along and about its axes, where all can follow."""
    index = {parameter.name: i for i, parameter in enumerate(space.table)}
    for frame, names in frames.items():
        where = np.array([[index[f"{name}.{axis}"] for axis in "xyz"] for name in names])
        for k, axis in enumerate("xyz"):
            unit = np.eye(3)[k]
            for words, motion in (
                (f"a shift of all {frame} points along {axis}", np.tile(unit, (len(names), 1))),
                (f"a turn of all {frame} points about {axis}", np.cross(unit, at[where])),
            ):
                full = np.zeros(len(at))
                full[where] = motion
                change = space.reduce(full)
                follows = np.abs(space.expansion @ change - full).max() <= 1e-9 * np.abs(full).max()
                if motion.any() and follows:
                    yield words, change


def _words(space: ParameterSpace, change: Array, order: NDArray[np.intp], at: Array) -> str:
    names = [space.names[i] for i in order]
    if len(order) == 1:
        return f"{names[0]}, which no pose shows"
    table = [space.table[space.identified[i]] for i in order]
    first, second = (float(change[i]) for i in order[:2])
    if len(order) == 2 and table[0].dimension == table[1].dimension:
        names.sort(key=space.names.index)
        for sign, word in ((-1.0, "sum"), (1.0, "difference")):
            if abs(second - sign * first) <= _EQUAL * abs(first):
                return f"{names[0]} and {names[1]}, seen only as their {word}"
        names = [space.names[i] for i in order]
    lead = change[order[0]] / step_of(table[0], at[space.identified[order[0]]])[1]
    terms = []
    for i, parameter in list(zip(order, table, strict=True))[:_MOST_NAMED]:
        unit, step = step_of(parameter, at[space.identified[i]])
        terms.append(f"{change[i] / step / lead:+.3g} {unit} of {space.names[i]}")
    rest = len(order) - len(terms)
    hidden = _listed([*terms[1:], *([f"{rest} more changes"] if rest else [])])
    shown = names[:_MOST_NAMED] + ([f"{rest} more"] if rest else [])
    return f"{_listed(shown)}, seen only together: {terms[0]} is undone by {hidden}"


def step_of(parameter: Parameter, value: float) -> tuple[str, float]:
    """The unit in which a person thinks of a change of ``parameter`` at ``value``, and its size in SI."""
    if parameter.dimension in _STEPS:
        return _STEPS[parameter.dimension]
    return "%", 0.01 * (abs(value) or 1.0)


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
