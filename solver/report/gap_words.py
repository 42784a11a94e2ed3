"""What a gap analysis found, in words: for the terminal and for the page alike.

Owns how effects, sizes, evidence and what is left open are called. Refuses to judge: the
verdict and its reasons come with the analysis.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from recordings.rig.quantity import SHOWN
from solver.gap.result import STRANGEST, Gap, Limit, MissingEffect, Rival, Verdict
from solver.gap.unknown import Pattern
from solver.report.notation import decimals_for, figures, fine_unit, fixed, unit_for

_PHRASES = {
    "gain-error": "gain error of {}",
    "nonlinearity": "nonlinearity of {}",
    "eccentricity": "eccentricity of {}",
    "cyclic-error": "cyclic error of {}",
    "backlash": "backlash of {}",
    "offset-drift": "drift of the zero of {}",
    "offset-jump": "jump of the zero of {}",
    "lag": "lag of {}",
    "stuck-bit": "stuck bit of {}",
    "saturation": "saturation of {}",
    "joint-compliance": "compliance of {}",
    "bearing-compliance": "compliance of {} across its axis",
    "fixture-compliance": "compliance of the fixture at {}",
    "fixture-slip": "slip of the fixture at {}",
    "link-geometry": "wrong value of {}",
    "axis-offset": "offset of the axes or ends at {}",
    "thermal-growth": "thermal growth of the {}",
}
_ROUGH = 0.3  # of a time constant: a larger standard error is not told, but few digits are
_SHAPES = frozenset({"nonlinearity", "eccentricity", "cyclic-error"})  # told by their RMS
_DIMENSIONS = {unit: dimension for dimension, (unit, _) in SHOWN.items()}


def called(name: str, where: str) -> str:
    """An effect as a person would call it; one of a user's own by its name."""
    if name == "crosstalk":
        to, _, source = where.partition("<-")
        return f"crosstalk from {source} into {to}"
    if name.startswith("fixture-") and where == "fixture":
        return _PHRASES[name].removesuffix(" at {}")
    return _PHRASES.get(name, f"{name} at {{}}").format(where)


def amount(size: float, unit: str, error: float | None = None) -> str:
    """A size that is stored in ``unit``, with its standard error, in a unit that is easy to read."""
    dimension = _DIMENSIONS.get(unit)
    if dimension is None:
        digits = decimals_for(math.nan if error is None else error)
        return (
            f"{figures(size)} {unit}"
            if error is None
            else f"{fixed(size, digits)} ± {fixed(error, digits)} {unit}"
        )
    si = SHOWN[dimension][1]
    shown = (
        fine_unit(dimension, size * si) if dimension in ("length", "angle") else unit_for(dimension)
    )
    value = size * si / shown.to_si
    if error is None or not error > 0:
        return f"{figures(value)} {shown.name}"
    spread = error * si / shown.to_si
    digits = decimals_for(spread)
    return f"{fixed(value, digits)} ± {fixed(spread, digits)} {shown.name}"


def sized(effect: MissingEffect | Rival) -> str:
    """How big an effect is, with its standard error."""
    told = amount(effect.size, effect.unit, effect.standard_error)
    return f"{told} RMS" if effect.name in _SHAPES else told


def in_full(effect: MissingEffect) -> str:
    """How big an effect is, and its `form`."""
    return ", ".join(part for part in (sized(effect), form(effect)) if part)


def form(effect: MissingEffect) -> str:
    """When, how often or how slowly it does what it does; nothing where there is no more to it than its size."""
    values = effect.entry.values
    if "decay" in values and values["decay"].nominal > 0:
        time_s = 1.0 / values["decay"].nominal
        error = (values["decay"].uncertainty or 0.0) * time_s**2
        told = f"about {figures(time_s, 2)} s"
        if 0.0 < error < _ROUGH * time_s:
            digits = decimals_for(error)
            told = f"{fixed(time_s, digits)} ± {fixed(error, digits)} s"
        return f"the mean speed; it slows down with a time constant of {told}"
    if "at" in values:
        return f"{figures(values['at'].nominal)} s after the beginning"
    if "harmonic" in values:
        return f"{figures(values['harmonic'].nominal)} periods a turn"
    return ""


def headline(gap: Gap) -> str:
    """The verdict in one sentence or two."""
    if gap.verdict is Verdict.NOTHING:
        told = "Nothing detectable is missing: the rig as described explains the readings."
    elif gap.verdict is Verdict.UNKNOWN:
        told = "Something is missing, and it is none of the effects that are known."
    else:
        parts = [f"{called(e.name, e.where)}, {in_full(e)}" for e in gap.effects]
        told = f"Missing: {'; and '.join(parts)}."
        if gap.verdict is Verdict.AMBIGUOUS:
            others = listed(
                dict.fromkeys(called(r.name, r.where) for e in gap.effects for r in e.could_also_be)
            )
            told += f" This recording cannot tell it from {others}."
        if gap.doubtful:
            told += " Poses that took no part do not bear it out."
    return f"{told} Provisional." if gap.provisional else told


def odds(log_evidence: float) -> str:
    """How likely a rival is beside the effect that is named, for ``log_evidence`` of at most 0."""
    if log_evidence > -1.0:
        return "about as likely"
    if log_evidence > -3.0:
        return f"less likely, about 1 : {math.exp(-log_evidence):.0f}"
    if log_evidence > -7.0:
        return f"much less likely, about 1 : {figures(math.exp(-log_evidence), 1)}"
    return "far less likely, less than 1 : 1000, but not excluded"


def rivals(effect: MissingEffect) -> str:
    """What an effect cannot be told from."""
    if not effect.could_also_be:
        return "nothing else that was tested: every other effect leaves something behind"
    return "; ".join(
        f"{called(r.name, r.where)} of {sized(r)} ({odds(r.log_evidence)})"
        for r in effect.could_also_be
    )


def evidence(effect: MissingEffect) -> str:
    """How sure an effect is, and how much of it the geometry leaves to be seen."""
    return (
        f"it takes {figures(effect.explained)} noise units off the sum of squares "
        f"({figures(math.sqrt(max(effect.explained, 0.0)), 2)} standard errors); the rig's parameters could "
        f"have taken up all but {figures(100.0 * effect.retained, 2)} % of its trace"
    )


def gap_closed(gap: Gap) -> str:
    """The gap on held-out poses, before and after."""
    held = gap.held_out
    if held is None:
        return f"not tested: {len(gap.table.counts)} poses are too few to hold any out"
    before = f"{_beside(held.before, held.before_error)}"
    if not gap.effects:
        return f"{before} on {held.poses} held-out poses, where 1 is noise alone"
    told = (
        f"{before} before, {_beside(held.after, held.after_error)} after, "
        f"on {held.poses} held-out poses, where 1 is noise alone"
    )
    if held.closed is None:
        return f"{told}; there was no significant gap on them"
    return f"{told}; {share(held.closed)} of the gap is closed"


def share(closed: float) -> str:
    """A share in per cent, that never rounds up to all of it."""
    return "more than 99.9 %" if 0.9995 <= closed < 1.0 else f"{100.0 * closed:.1f} %"


def _beside(value: float, error: float) -> str:
    digits = min(decimals_for(error), 3)
    return f"{fixed(value, digits)} ± {fixed(error, digits)}"


def noise_floor(gap: Gap) -> tuple[str, ...]:
    """What noise is known from, and whether the model reaches it."""
    before, after = gap.floor_before, gap.floor_after
    best = after if gap.effects else before
    if before.provisional:
        known = (
            "No pose was visited again. The noise within dwells stands in for all noise, and whatever else "
            "differs from visit to visit would be taken for an effect: the verdict is provisional."
        )
    else:
        known = (
            f"{before.revisited} poses were visited again. Their readings scatter, from visit to visit, "
            f"{figures(math.sqrt(best.variance))} times as much as noise within a dwell explains "
            f"({before.freedoms} degrees of freedom)."
        )
    told = [
        known,
        f"Lack of fit of the rig as described: F = {figures(before.ratio)}, {chance(before.p)}.",
    ]
    if gap.effects:
        told.append(
            f"With what was found: F = {figures(after.ratio)}, {chance(after.p)}. "
            "F near 1 means that the model explains all but noise."
        )
    return tuple(told)


def alone(found: Pattern) -> str:
    """How likely chance is to make as much of one pattern that was not chosen from many."""
    return chance(math.exp(found.log_p))


def chance(p: float) -> str:
    """A p-value."""
    return "p < 1e-6" if p < 1e-6 else f"p = {figures(p, 2)}"


def limits_by_name(found: Sequence[Limit]) -> dict[str, list[Limit]]:
    """Limits of each effect, in catalogue order."""
    out: dict[str, list[Limit]] = {}
    for limit in found:
        out.setdefault(limit.name, []).append(limit)
    return out


@dataclass(frozen=True, slots=True)
class Limits:
    """Detection limits of one effect over its places: where the recording sees it best and worst."""

    name: str
    places: int
    best: Limit
    worst: Limit


def limits_by_effect(found: Sequence[Limit]) -> tuple[Limits, ...]:
    """A row an effect and unit, in catalogue order."""
    groups: dict[tuple[str, str], list[Limit]] = {}
    for limit in found:
        groups.setdefault((limit.name, limit.unit), []).append(limit)
    return tuple(
        Limits(
            name,
            len(group),
            min(group, key=lambda each: each.size),
            max(group, key=lambda each: each.size),
        )
        for (name, _), group in groups.items()
    )


@dataclass(frozen=True, slots=True)
class Open:
    """Effects at some places that could not be tested for one reason."""

    name: str
    places: tuple[str, ...]
    reason: str

    @property
    def at(self) -> str:
        """The places in short."""
        return listed(self.places)


def untested(gap: Gap) -> tuple[Open, ...]:
    """What could not be tested, grouped by effect and reason."""
    groups: dict[tuple[str, str], list[str]] = {}
    for each in gap.untested:
        groups.setdefault((each.name, each.reason), []).append(each.where)
    return tuple(Open(name, tuple(places), reason) for (name, reason), places in groups.items())


def listed(names: Iterable[str], most: int = 8) -> str:
    """Names with commas; of many, the first ones and how many more."""
    every = list(names)
    if len(every) <= most:
        return ", ".join(every)
    return f"{', '.join(every[:most])} and {len(every) - most} more"


def advice(gap: Gap, *, page: bool = False) -> tuple[str, ...]:
    """What to do next, in the order in which to do it; ``page`` where the pictures are at hand."""
    out = []
    if gap.provisional:
        out.append(
            "Record again with poses that are visited three times or more ([plan] revisit): "
            "only then is noise known, and the verdict firm."
        )
    if gap.doubtful:
        out.append(
            "Do not build on the name yet. Record more poses, and analyse all together, `loopcal gap FILE MORE`: a name "
            "that stays, and closes the gap on poses that took no part, can be relied on."
        )
    if gap.verdict is Verdict.NAMED and not gap.doubtful:
        out.append(
            "Take the effect into the rig: `--rig-out RIG` writes it with the effect and its size; "
            "`loopcal capture RIG` and `loopcal solve` then calibrate it with everything else."
        )
    elif gap.verdict is Verdict.AMBIGUOUS:
        out.append(
            "Record poses that tell the rivals apart (a wider range of the channel, another load, another "
            "direction of approach), and analyse again: `--next PLAN` plans them, and `loopcal gap FILE MORE` takes "
            "both recordings together. Until then `--rig-out RIG` writes the likeliest."
        )
    elif gap.verdict is Verdict.UNKNOWN:
        if strangest(gap):
            where = "the picture below" if page else "`--report PAGE` draws it"
            out.append(f"Look at {pattern(gap.unknown.patterns[0])}: {where}.")
        out.append(
            "Check what no description covers: a loose part, a wrong mechanism or fixture in the rig, a channel "
            "that is wired to another joint. You can add effects of your own (docs/howto-own-effect.md)."
        )
    elif gap.verdict is Verdict.NOTHING:
        need = "" if out else "Nothing needs to be done. "
        out.append(f"{need}Effects below the detection limits may still be at work.")
    if gap.held_out is None:
        out.append(
            "Record more poses: with ten or more distinct ones the gap is tested on poses that are held out."
        )
    return tuple(out)


def strangest(gap: Gap) -> tuple[Pattern, ...]:
    """The patterns of no known effect that are left, most significant first; none where they may be chance."""
    return gap.unknown.strangest(STRANGEST) if gap.unknown.p < _STRANGE else ()


def pattern(found: Pattern) -> str:
    """A pattern as a person would call it."""
    return f"{found.channel} over {over(found)}"


def over(found: Pattern) -> str:
    """What a pattern goes with."""
    return _OVER.get(found.over, found.over)


_STRANGE = 0.05  # p-value of the strangest
_OVER = {
    "pose": "the pose",
    "time": "time",
    "swing": "time, as a swing up and down",
    "move": "how far it went to get there",
}
