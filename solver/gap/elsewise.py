"""What else than poses tells two rivals apart: side of approach, payload, time, speed; or nothing.

The stops of a proposed session are looked at again under other circumstances, one after the other,
and the separation that each would reach is told. Owns which circumstance is worth trying, and the
plain word where none is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from solver.effects.effect import Effect
from solver.gap.next_poses import NextPoses, Pair
from solver.gap.separation import Contest
from solver.mechanism.circumstances import Circumstances

_SURE = 0.8  # chance from which on poses are enough
_PAYLOAD = 1.5  # times the loads
_LATER_S = 3600.0
_GAINED = 2.0  # times the separation that the poses alone reach: less is not worth the trouble


@dataclass(frozen=True)
class Elsewise:
    """How a pair may be told apart that poses do not tell apart surely.

    Attributes:
        effect, other: labels.
        how: "direction", "payload", "time" or "speed"; "evidence" where one effect can do all that
            the other does, "nothing" where both do the same.
        separation: lambda that the same stops reach so; None where it cannot be computed.
    """

    effect: str
    other: str
    how: str
    separation: float | None

    @property
    def text(self) -> str:
        """In words for the user."""
        pair = f"{self.effect} from {self.other}"
        reached = "" if self.separation is None else f" (separation {self.separation:.3g})"
        return {
            "direction": f"To tell {pair}, approach poses from the other side as well{reached}.",
            "payload": f"To tell {pair}, repeat the poses with another payload, such as half as much load again, "
            f"with its mass in the rig{reached}.",
            "time": f"To tell {pair}, repeat the poses later in a session, an hour after its beginning{reached}.",
            "speed": f"To tell {pair}, move at another speed between the poses: only readings in motion tell.",
            "evidence": f"No feasible pose tells {pair}: {self.other} can do all that {self.effect} does. "
            f"If {self.effect} is at work, only its simplicity speaks for it.",
            "nothing": f"Nothing feasible tells {pair}: within reach they do the same, or so nearly that the exact shape "
            "of either would hide the rest. "
            "Fix one of them by a measurement of another kind.",
        }[self.how]


def elsewise(proposal: NextPoses) -> tuple[Elsewise, ...]:
    """One entry a pair that the proposed poses do not tell apart surely, in both directions."""
    by_names = {(p.effect, p.other): p for p in proposal.pairs}
    effects = {c.effect.label: c.effect for c in proposal.contests}
    out, seen = [], set()
    for pair in proposal.pairs:
        back = by_names.get((pair.other, pair.effect))
        if back is None or (pair.other, pair.effect) in seen:
            continue
        seen.add((pair.effect, pair.other))
        if min(pair.chance, back.chance) >= _SURE:
            continue
        weaker, stronger = sorted((pair, back), key=lambda p: p.chance)
        found = _otherwise(proposal, weaker, effects)
        if found is None and not weaker.separable:
            how = "evidence" if stronger.separable else "nothing"
            found = Elsewise(weaker.effect, weaker.other, how, None)
        if found is not None:
            out.append(found)
    return tuple(out)


def _otherwise(proposal: NextPoses, pair: Pair, effects: Mapping[str, Effect]) -> Elsewise | None:
    """The circumstance, by which the two differ, that separates them best."""
    contest = next(c for c in proposal.contests if c.effect.label == pair.effect)
    differing = set(effects[pair.effect].needs) ^ set(effects[pair.other].needs)
    best: Elsewise | None = None
    for how, (needed, changed) in _CHANGES.items():
        if not differing & needed:
            continue
        reached = _separation(proposal, contest, pair.other, changed)
        if reached > max(_GAINED * pair.proposed, 1.0) and (
            best is None or reached > (best.separation or 0.0)
        ):
            best = Elsewise(pair.effect, pair.other, how, reached)
    if best is None and "rate" in differing:
        return Elsewise(pair.effect, pair.other, "speed", None)
    return best


def _separation(
    proposal: NextPoses,
    contest: Contest,
    other: str,
    changed: Callable[[Circumstances], tuple[Circumstances, ...]],
) -> float:
    """Of the stops under changed circumstances, with all that was captured."""
    sums = contest.captured()
    variants = changed(proposal.visited.at)
    for at in variants:
        more = contest.each(proposal.visited.stops, at, proposal.reach.sigma)
        sums = sums + more.sum(axis=0) / len(variants)
    return float(contest.separation(sums)[contest.rivals.index(other)])


def _from_both_sides(at: Circumstances) -> tuple[Circumstances, ...]:
    if at.approach is None:
        return (at,)
    return tuple(replace(at, approach=np.full(at.approach.shape, side)) for side in (1.0, -1.0))


def _loaded(at: Circumstances) -> tuple[Circumstances, ...]:
    known = (at.torque, at.force, at.moment)
    return (at.loaded(*(None if load is None else _PAYLOAD * load for load in known)),)


def _later(at: Circumstances) -> tuple[Circumstances, ...]:
    return (at if at.time_s is None else replace(at, time_s=at.time_s + _LATER_S),)


_CHANGES: Mapping[
    str, tuple[frozenset[str], Callable[[Circumstances], tuple[Circumstances, ...]]]
] = {
    "direction": (frozenset({"approach"}), _from_both_sides),
    "payload": (frozenset({"torque", "force", "moment"}), _loaded),
    "time": (frozenset({"time_s"}), _later),
}
