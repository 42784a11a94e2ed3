"""Every effect that may be missing, at every place, in every form that the recording asks for.

Owns which candidates are tested and which cannot be, with the reason in words. An effect that
the model has already is no candidate again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from solver.effects.effect import Effect, Recorded
from solver.effects.registry import effect_kinds
from solver.gap.channels import moved
from solver.gap.fit import Fit


@dataclass(frozen=True)
class Candidate:
    """One effect at one place, in the forms that are tried; the forms of one candidate are rivals."""

    name: str
    where: str
    variants: tuple[Effect, ...]

    @property
    def label(self) -> str:
        """``name@where``."""
        return f"{self.name}@{self.where}"


@dataclass(frozen=True)
class Untestable:
    """An effect that this recording cannot show at one place or at any, and why."""

    name: str
    where: str
    reason: str


def _still(fit: Fit, where: str) -> str | None:
    """Why nothing can be told of a channel that never moved, in words; None for all others."""
    if where not in fit.model.channels:
        return None
    if moved(fit)[fit.model.channels.index(where)]:
        return None
    return f"the readings of {where} did not change"


def candidates(
    fit: Fit, leave_out: Iterable[str] = ()
) -> tuple[tuple[Candidate, ...], tuple[Untestable, ...]]:
    """What may be missing from ``fit``.

    Args:
        fit: the present model.
        leave_out: labels that are not to be tried, beside the fit's own effects.
    """
    site, recorded = fit.model.site, Recorded(fit.values, fit.at, fit.observed.counts)
    out = {*leave_out, *(effect.label for effect in fit.effects)}
    testable: list[Candidate] = []
    hopeless: list[Untestable] = []
    for name, kind in effect_kinds().items():
        for where in kind.places(site):
            reason = _still(fit, where) or kind.untestable(site, where, fit.at)
            if reason is not None:
                hopeless.append(Untestable(name, where, reason))
            elif f"{name}@{where}" not in out:
                variants = kind.variants(site, where, recorded)
                if variants:
                    testable.append(Candidate(name, where, variants))
    return tuple(testable), tuple(hopeless)
