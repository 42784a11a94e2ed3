"""The answer of a gap analysis, as data, and as the JSON that other programs read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

from recordings.rig import DescribedEffect
from solver.gap.candidates import Untestable
from solver.gap.cautions import cautions
from solver.gap.channels import Disagreement
from solver.gap.fit import Fit
from solver.gap.floor import Floor
from solver.gap.held_out import HeldOut
from solver.gap.search import Search
from solver.gap.unknown import Unknown
from solver.samples import PoseTable

SCHEMA = 1

STRANGEST = 5
"""Patterns of no known effect that are told."""

ABSORBED = (
    "the parameters that are identified can take up all that it would do at these poses, so that "
    "no reading would show it"
)
"""Why an effect cannot be named whose trace the geometry absorbs."""


class Verdict(Enum):
    """What a gap analysis concludes."""

    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    NOTHING = "nothing-detectable"
    UNKNOWN = "none-of-the-known"


@dataclass(frozen=True)
class Rival:
    """An effect that could stand in another's place.

    Attributes:
        log_evidence: against the effect named, natural log; above 0 favours the rival.
        size, standard_error, unit: as of the effect named.
    """

    name: str
    where: str
    log_evidence: float
    size: float
    standard_error: float
    unit: str


@dataclass(frozen=True)
class MissingEffect:
    """One effect of the answer.

    Attributes:
        name, where: which, and at what.
        size: in ``unit``: the coefficient, or of a shape its RMS over the recording.
        standard_error: of the size.
        unit: SI, or degrees for angles.
        could_also_be: effects that this data cannot tell from it, most likely first.
        explained: chi-square that it takes away, in units of the noise that is left.
        retained: kappa, the fraction of its trace that the geometry does not absorb.
        entry: as the rig file describes it.
    """

    name: str
    where: str
    size: float
    standard_error: float
    unit: str
    could_also_be: tuple[Rival, ...]
    explained: float
    retained: float
    entry: DescribedEffect


@dataclass(frozen=True)
class Limit:
    """The smallest size of an effect that this recording would have shown in 9 of 10 cases."""

    name: str
    where: str
    size: float
    unit: str


@dataclass(frozen=True)
class Gap:
    """A whole gap analysis.

    Attributes:
        verdict: the conclusion.
        provisional: whether no pose was visited again, so that the noise floor is but assumed.
        reasons: what the verdict rests on, in sentences for the user.
        effects: what is missing; empty for the verdicts that name nothing.
        table: the poses.
        before: the model as it was.
        after: the model with what was found; the same where nothing was.
        floor_before, floor_after: noise floor and lack of fit of both.
        p: family-wise p-value of the first screen.
        unknown: patterns that are left, of no known effect.
        limits: what would have been detected.
        untestable: effects that this recording cannot show, and why.
        held_out: the gap on held-out poses, or None where they are too few.
        disagreement_before, disagreement_after: each channel against the rest of the loop.
        search: all that was tried.
    """

    verdict: Verdict
    provisional: bool
    reasons: tuple[str, ...]
    effects: tuple[MissingEffect, ...]
    table: PoseTable
    before: Fit
    after: Fit
    floor_before: Floor
    floor_after: Floor
    p: float
    unknown: Unknown
    limits: tuple[Limit, ...]
    untestable: tuple[Untestable, ...]
    held_out: HeldOut | None
    disagreement_before: Disagreement
    disagreement_after: Disagreement
    search: Search

    @cached_property
    def cautions(self) -> tuple[str, ...]:
        """What speaks against the answer, in sentences for the user.

        Single poses that stand out are told only where a model is said to explain the readings.
        """
        explained = self.verdict is not Verdict.UNKNOWN
        return cautions(
            self.after,
            self.disagreement_after if explained else None,
            self.table,
            self.held_out if self.effects or not explained else None,
            None if explained else self.floor_before,
        )

    @property
    def doubtful(self) -> bool:
        """Whether something was named that poses which took no part do not bear out."""
        return bool(self.effects) and self.held_out is not None and self.held_out.left_open

    @property
    def untested(self) -> tuple[Untestable, ...]:
        """`untestable`, and the candidates whose whole trace the parameters absorb."""
        looked = self.search.before
        seen = {form.candidate for form in looked.forms}
        absorbed = (c for i, c in enumerate(looked.candidates) if i not in seen)
        return (*self.untestable, *(Untestable(c.name, c.where, ABSORBED) for c in absorbed))


def gap_json(gap: Gap, next_poses: str | None = None) -> dict[str, Any]:
    """The answer as plain data; ``next_poses`` is the path of a plan that was written, if one was."""
    held = gap.held_out
    answer = {
        "schema": SCHEMA,
        "verdict": gap.verdict.value,
        "provisional": gap.provisional,
        "reasons": list(gap.reasons),
        "cautions": list(gap.cautions),
        "effects": [
            {
                "name": effect.name,
                "where": effect.where,
                "size": effect.size,
                "unit": effect.unit,
                "standard_error": effect.standard_error,
                "could_also_be": [
                    {
                        "name": rival.name,
                        "where": rival.where,
                        "size": rival.size,
                        "unit": rival.unit,
                        "standard_error": rival.standard_error,
                        "log_evidence": rival.log_evidence,
                    }
                    for rival in effect.could_also_be
                ],
            }
            for effect in gap.effects
        ],
        "gap": None
        if held is None
        else {
            "before": held.before,
            "before_standard_error": held.before_error,
            "after": held.after,
            "after_standard_error": held.after_error,
            "closed": held.closed,
            "held_out_poses": held.poses,
        },
        "noise_floor": {
            "revisited_poses": gap.floor_before.revisited,
            "freedoms": gap.floor_before.freedoms,
            "lack_of_fit_before": gap.floor_before.ratio,
            "p_before": gap.floor_before.p,
            "lack_of_fit_after": gap.floor_after.ratio,
            "p_after": gap.floor_after.p,
        },
        "screen_p": gap.p,
        "patterns": {
            "p": gap.unknown.p,
            "strangest": [
                {"channel": pattern.channel, "over": pattern.over, "chi_square": pattern.explained}
                for pattern in gap.unknown.strangest(STRANGEST)
            ],
        },
        "detection_limits": [
            {"name": limit.name, "where": limit.where, "size": limit.size, "unit": limit.unit}
            for limit in gap.limits
        ],
        "untestable": [
            {"name": u.name, "where": u.where, "reason": u.reason} for u in gap.untested
        ],
        "next_poses": next_poses,
    }
    return {key: _finite(value) for key, value in answer.items()}


def _finite(value: Any) -> Any:
    """``value`` with None for every number that is not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
