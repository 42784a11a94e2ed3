"""What coincides in a rig and must not: an unsensed axis with another axis, a fixture with another.

Two revolute joints on one axis act by the sum of their angles alone: where one of them is
unsensed, nothing senses that sum, and they turn against each other freely. A second fixture in
the place of the first closes the same loop again, and a known distance between them cannot be kept.

Owns finding both in the geometry, and the words for it; mends nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from recordings.rig import POSE, Rig, SerialMechanism, parameters
from solver.mechanism.chain import Chain
from solver.mechanism.links import pose_motions
from solver.mechanism.rotation import logarithm
from solver.mechanism.serial import SerialModel
from solver.mechanism.tracker import without_trackers

Array = NDArray[np.float64]

_CONFIGURATIONS = 6
_ANGLE, _LENGTH = 1e-4, 1e-5  # rad, m: no more than the rounding of numbers in a rig
_KEPT = 0.05  # of a known distance: more is not its uncertainty
_SIGMAS = 10.0
_REMEDY = (
    "Correct the places, or the fixture that each dwell names; or move one fixture away from the other "
    "and record again."
)


@dataclass(frozen=True, slots=True)
class Coincidence:
    """Two things in one place.

    Attributes:
        names: both.
        sure: whether they coincide as stated; otherwise only within what is uncertain.
        contradicted: whether a known distance says that they are apart.
        text: what was seen, what it means and what to do.
    """

    names: tuple[str, str]
    sure: bool
    contradicted: bool
    text: str


def coaxial_joints(rig: Rig) -> tuple[Coincidence, ...]:
    """Unsensed turns of ``rig`` that share the axis of another turn at every pose, as it states them.

    The loop is gone round twice at random coordinates, so that the joints on both sides of the
    place where it closes are neighbours too: nothing needs to close. Axes that coincide at all
    of these have nothing between them that could part them.
    """
    if not isinstance(rig.mechanism, SerialMechanism):
        return ()
    table = parameters(rig)
    model = SerialModel.of(without_trackers(rig), table)
    x = np.array([p.nominal for p in table])
    sigma = np.array([p.uncertainty or 0.0 for p in table])
    unknown = np.array([p.identify and p.uncertainty is None for p in table])
    unknown &= np.isin(np.arange(len(table)), model.fixture_parameters)
    once = len(model.chain.motions)
    motions = (*model.chain.motions, *model.chain.motions)
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (_CONFIGURATIONS, len(model.coordinate_names)))
    turns = [m for m, one in enumerate(motions) if one.kind == "turn" and one.coordinate >= 0]
    found: dict[frozenset[int], Coincidence] = {}
    for second in turns:
        # The chain ends on the second axis: a screw's moment is then what it does to that point.
        screws = Chain(motions[: second + 1]).reach(at, x).screws
        axis = screws[:, 3:, second]
        for first in (m for m in turns if second - once < m < second):
            pair = frozenset((motions[first].coordinate, motions[second].coordinate))
            if len(pair) < 2 or pair.isdisjoint(model.unsensed.tolist()) or pair in found:
                continue
            which = model.parameter_of[np.arange(first, second) % once]
            between, which = np.arange(first, second)[which >= 0], which[which >= 0]
            if unknown[which].any():
                continue
            along = screws[:, 3:, first]
            angle = np.linalg.norm(np.cross(along, axis), axis=1).max()
            apart = np.linalg.norm(screws[:, :3, first], axis=1).max()
            moved = _across(screws[:, :3, between], along) * sigma[which]
            turned = _across(screws[:, 3:, between], along) * sigma[which]
            if angle < _ANGLE + _size(turned) and apart < _LENGTH + _size(moved):
                sure = bool(angle < _ANGLE and apart < _LENGTH)
                found[pair] = _told(rig, model, pair, sure)
    return tuple(found.values())


def _across(vectors: Array, along: Array) -> Array:
    """(P, M) length of ``vectors`` (P, 3, M) across ``along`` (P, 3)."""
    return np.asarray(np.linalg.norm(np.cross(vectors, along[:, :, None], axis=1), axis=1))


def _size(parts: Array) -> float:
    """Largest root sum of squares of ``parts`` (P, M) over the configurations."""
    return float(np.linalg.norm(parts, axis=1).max())


def _told(rig: Rig, model: SerialModel, pair: frozenset[int], sure: bool) -> Coincidence:
    lone, other = sorted(pair, key=lambda j: (j not in model.unsensed, j))
    hinge, partner = (model.coordinate_names[j] for j in (lone, other))
    channel = rig.sensed_by(partner)
    lost = (
        "no reading tells of it" if channel is None else f"what {channel.name} reads tells nothing"
    )
    how = (
        "have one and the same axis"
        if sure
        else "may have one and the same axis, within the uncertainties stated"
    )
    place = "the endpoint's hinge in its holder" if hinge.startswith("end.") else "unsensed"
    return Coincidence(
        (hinge, partner),
        sure,
        False,
        f"{hinge} ({place}) and {partner} {how}: only the sum of their angles acts, which nothing senses; they can "
        f"turn against each other, and {lost}. Mount {hinge} on another axis, askew or beside that of {partner}, "
        "or lock one of the two and take it out of the rig.",
    )


def coincident_fixtures(rig: Rig) -> tuple[Coincidence, ...]:
    """Pairs of fixtures that ``rig`` states in one place, up to the freedoms of the endpoint in them.

    Fixtures whose place it does not know (identified, without uncertainty) are left out.
    """
    mechanism = rig.mechanism
    if not isinstance(mechanism, SerialMechanism):
        return ()
    table = parameters(rig)
    index = {p.name: i for i, p in enumerate(table)}
    x = np.array([p.nominal for p in table])
    found = []
    for names in combinations(mechanism.fixture_names, 2):
        stated = [[table[index[f"{name}.{part}"]] for part in POSE] for name in names]
        if any(p.identify and p.uncertainty is None for row in stated for p in row):
            continue
        one, two = (Chain(tuple(pose_motions(n, index))).reach(np.zeros((1, 0)), x) for n in names)
        apart = float(np.linalg.norm(two.position - one.position))
        angle = _turned(one.rotation[0], two.rotation[0], mechanism.closure.freedoms)
        sigma = np.array([[p.uncertainty or 0.0 for p in row] for row in stated])
        length, turn = float(np.linalg.norm(sigma[:, :3])), float(np.linalg.norm(sigma[:, 3:]))
        if apart > _LENGTH + length or angle > _ANGLE + turn:
            continue
        told = next((d for d in mechanism.distances if set(d.between) == set(names)), None)
        known = 0.0 if told is None else told.distance.nominal
        contradicted = abs(known - apart) > 3.0 * length + _LENGTH and told is not None
        text = (
            f"fixtures {names[0]} and {names[1]} are in one and the same place as the rig states them "
            f"({1e3 * apart:.3g} mm apart): the second tells nothing that the first does not"
        )
        if contradicted:
            text += f", and the known distance of {1e3 * known:.4g} mm between them contradicts it"
        sure = apart < _LENGTH and angle < _ANGLE
        found.append(Coincidence(names, sure, contradicted, f"{text}. {_REMEDY}"))
    return tuple(found)


def contradicted_distances(rig: Rig, at: Array) -> tuple[str, ...]:
    """Known distances that fixtures at the estimate ``at`` (N,) are far from keeping, in words.

    Such as where dwells in one place bear the names of two.
    """
    mechanism = rig.mechanism
    if not isinstance(mechanism, SerialMechanism):
        return ()
    value = {p.name: x for p, x in zip(parameters(rig), at, strict=False)}
    texts = []
    for d in mechanism.distances:
        one, two = (np.array([value[f"{name}.{axis}"] for axis in "xyz"]) for name in d.between)
        apart, known = float(np.linalg.norm(two - one)), d.distance.nominal
        if abs(apart - known) > max(_KEPT * known, _SIGMAS * (d.distance.uncertainty or 0.0)):
            texts.append(
                f"The rig states {1e3 * known:.4g} mm between fixtures {d.between[0]} and {d.between[1]}, the readings "
                f"put them {1e3 * apart:.4g} mm apart: the distance is wrong, or dwells bear the name of the other "
                f"fixture, or both are one and the same place. {_REMEDY}"
            )
    return tuple(texts)


def _turned(one: Array, two: Array, freed: frozenset[str]) -> float:
    """Angle [rad] between rotations (3, 3) that the freedoms ``freed`` of the endpoint leave."""
    free = [axis for axis, name in enumerate(("rx", "ry", "rz")) if name in freed]
    if len(free) == 3:
        return 0.0
    if len(free) == 1:
        first, second = one[:, free[0]], two[:, free[0]]
        return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))
    return float(np.linalg.norm(logarithm((one.T @ two)[None])[0]))
