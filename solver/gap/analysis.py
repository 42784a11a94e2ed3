"""The whole way from a recording to an answer: fit, screen, search, hold out, conclude.

Owns the order of the steps and the rules of the verdict. Reads top to bottom like the method
section of a paper; each step lives in a file of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from recordings.reader import Recording
from recordings.rig import DescribedEffect
from solver.drives import held_joints
from solver.effects.effect import Array, Site
from solver.effects.needs import require_shown
from solver.effects.registry import effect_kinds
from solver.errors import MechanismError, NotEnoughData
from solver.estimate import likelihood
from solver.estimate.nuisance import Observations, settle
from solver.gap.candidates import candidates
from solver.gap.channels import disagreement
from solver.gap.fit import Fit, refit
from solver.gap.floor import Floor, floor, same_poses
from solver.gap.held_out import HeldOut, held_out
from solver.gap.limits import limits
from solver.gap.missing import defect, missing
from solver.gap.raw_codes import censored, defects
from solver.gap.result import Gap, Verdict
from solver.gap.search import LEVEL, MORE, Search, look, search
from solver.gap.unknown import Unknown, unknown
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import mechanism_model
from solver.mechanism.space import ParameterSpace
from solver.mechanism.statics import loads
from solver.motion import with_motion
from solver.samples import PoseTable, average
from solver.solve import priors_complete

_LACK = 0.01  # p of the lack of fit below which a model is not enough
_STRANGE = 0.01  # the same of patterns of no known effect
_SHAPE = 0.03  # of what is named: less is but its exact shape
_GAIN = 2.0  # standard errors of the held-out gain that an answer without a floor needs
_UNSUPPORTED = (
    "Known effects come near ({}), but without revisits only poses that took no part can bear a name out, "
    "and they do not: too little of their gap closes. Record poses again, to learn the noise floor."
)


def analyse(
    recording: Recording,
    *,
    seed: int = 1,
    progress: Callable[[str, float], None] = lambda step, share: None,
) -> Gap:
    """What is missing from the rig of ``recording``.

    Args:
        recording: what was captured.
        seed: of the draws.
        progress: is told what is being done, and the share done.

    Raises:
        NotEnoughData: no dwells, a silent channel, or too few poses for the parameters.
        MechanismError: the loop does not close at the nominal parameters.
    """
    rng = np.random.default_rng(seed)
    table = average(recording)
    progress("fitting the rig as described", 0.0)
    broken = defects(recording, table)
    plain = first_fit(recording, table)
    fit = first_fit(recording, table, broken) if broken else plain
    level = MORE if broken else LEVEL
    found = search(fit, rng, lambda text: progress(text, 0.3), level=level)
    # Only motion shows a lag: readings in motion are added, and kept where one stands out.
    moving, _ = with_motion(recording, table)
    moves, kinds = len(moving.counts) > len(table.counts), effect_kinds()
    if moves and _lags(recording, moving, broken, found, rng):
        table = moving
        plain = first_fit(recording, table)
        fit = first_fit(recording, table, broken) if broken else plain
        found = search(fit, rng, lambda text: progress(text, 0.45), level=level)
    poses = same_poses(table.windows, table.counts)
    floors = floor(plain, poses), floor(found.after.fit, poses)
    left = unknown(found.after.fit, rng)
    verdict, reasons = _concluded(found, len(broken), floors, left)
    answered = (Verdict.NAMED, Verdict.AMBIGUOUS)
    final = found.after.fit if verdict in answered else fit
    variance = max(_variance(floors[verdict in answered], final), 1e-300)
    gap = held_out(
        plain,
        fit if broken else plain,
        final.effects[len(fit.effects) :],
        poses,
        variance,
        rng,
        found.before.screen.threshold,
        lambda share: progress("holding poses out", 0.6 + 0.4 * share),
    )
    if verdict in answered and floors[0].provisional and not _supported(gap):
        nearest = ", ".join(n.best.effect.label for n in found.named)
        verdict, reasons = Verdict.UNKNOWN, (reasons[0], _UNSUPPORTED.format(nearest))
    named = verdict in answered
    effects = (
        *(defect(plain, fit, entry) for entry in broken),
        *(missing(found, number) for number in range(len(found.named)) if named),
    )
    if verdict is Verdict.NAMED and any(effect.could_also_be for effect in effects):
        verdict = Verdict.AMBIGUOUS
    after = found.after.fit if named else fit
    noise = float(np.sqrt(variance))
    progress("done", 1.0)
    return Gap(
        verdict,
        floors[0].provisional,
        reasons,
        effects,
        table,
        plain,
        after,
        floors[0],
        floors[1] if named else floors[0],
        found.before.screen.p,
        left,
        limits(found.after if named else found.before),
        tuple(u for u in found.before.untestable if not moves or "rate" not in kinds[u.name].needs),
        gap,
        disagreement(plain, noise),
        disagreement(after, noise),
        found,
    )


def _supported(gap: HeldOut | None) -> bool:
    """Whether held-out poses bear out what was named, where no noise floor can."""
    if gap is None:
        return False
    gain = gap.each_before - gap.each_after
    gain = gain[~np.isnan(gain)]
    error = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return bool(gain.mean() > _GAIN * error and not gap.left_open)


def _lags(
    recording: Recording,
    moving: PoseTable,
    broken: Sequence[DescribedEffect],
    found: Search,
    rng: np.random.Generator,
) -> bool:
    """Whether a lag stands out of readings in motion, beside what was found at rest."""
    still = first_fit(recording, moving, broken)
    effects = (*still.effects, *(named.best.effect for named in found.named))
    start = np.concatenate(
        [still.parameters, *(_last_coefficients(n.best.after.fit) for n in found.named)]
    )
    fit = refit(
        still.model.site,
        effects,
        still.observed,
        start,
        still.settled.coordinates,
        priors=still.priors,
    )
    if fit is None:
        return False
    tested, hopeless = candidates(fit)
    moving_only = tuple(c for c in tested if "rate" in c.variants[0].needs)
    return look(fit, rng, pool=(moving_only, hopeless)).significant(MORE)


def _last_coefficients(fit: Fit) -> Array:
    return fit.coefficients(len(fit.effects) - 1)


def first_fit(
    recording: Recording, table: PoseTable, beside: Sequence[DescribedEffect] = ()
) -> Fit:
    """The rig as described, with the effects that it describes, fitted to all poses.

    Args:
        recording: whose rig and modes count.
        table: the poses.
        beside: effects that are known already though the rig does not describe them.

    Raises:
        NotEnoughData: too few poses for the parameters.
        MechanismError: the loop does not close.
    """
    rig = recording.rig
    site = Site(rig)
    observed = Observations(table.counts, table.sigma, table.circumstances(rig))
    space = ParameterSpace.of(site.table)
    plain = mechanism_model(site.rig, site.table)
    estimate = likelihood.identify(plain, space, observed)
    settled = settle(plain, observed, estimate.coordinates, estimate.parameters, space.expansion)
    priors = priors_complete(plain, space, settled, estimate.parameters)
    if priors:
        estimate = likelihood.identify(plain, space, observed, use_priors=True)
    kinds = effect_kinds()
    described = (*rig.effects, *beside)
    strangers = [e.name for e in described if e.name not in kinds]
    if strangers:
        raise MechanismError(
            f"rig '{rig.name}' has the effect '{strangers[0]}', which is not known; "
            f"known are: {', '.join(kinds)}"
        )
    # Of a rail there is nothing to model: the readings at it are worthless, the others untouched.
    described = tuple(e for e in described if e not in beside or e.name != "saturation")
    effects = [kinds[e.name].read(site, e) for e in described]
    coefficients = [
        entry.values[c.name].nominal
        for entry, effect in zip(described, effects, strict=True)
        for c in effect.coefficients
    ]
    held = held_joints(recording, table.windows)
    found = loads(rig, estimate.coordinates, estimate.parameters, held, observed.at)
    observed = Observations(
        table.counts,
        censored(table.sigma, table, beside),
        (observed.at or Circumstances()).loaded(found.torque, found.force, found.moment),
    )
    start = np.concatenate([estimate.parameters, coefficients])
    fit = refit(site, effects, observed, start, estimate.coordinates, priors=priors)
    if fit is None:
        raise MechanismError(
            f"the mechanism of rig '{rig.name}' does not close with these readings; "
            "`loopcal solve` says more, and has to succeed before a gap can be analysed"
        )
    unknowns = len(fit.space.identified)
    if fit.freedoms < 1 or len(table.counts) * fit.redundancy <= unknowns:
        raise NotEnoughData(
            f"{len(table.counts)} poses leave no equation to test the model by: {unknowns} unknowns, "
            f"{fit.redundancy} equations a pose. Record more poses."
        )
    require_shown(fit.model, fit.space, fit.at)
    return fit


def _variance(found: Floor, fit: Fit) -> float:
    """Of the noise in units of the assumed one: pooled where the fit reaches the floor."""
    return fit.rss / max(fit.freedoms, 1) if found.p > _LACK else found.variance


def _concluded(
    found: Search, broken: int, floors: tuple[Floor, Floor], left: Unknown
) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict, and what it rests on in words."""
    before, after = floors
    reasons = []
    if before.provisional:
        reasons.append(
            f"Only {before.revisited} poses were visited again, so noise from visit to visit is hardly known: "
            "the verdict is provisional."
        )
    if broken:
        reasons.append(
            "Raw codes show a defect of a converter by themselves, whatever the mechanism."
        )
    remainder = _remainder(found, after)
    lacking = after.p < _LACK and remainder > _SHAPE
    pattern = left.patterns[0].explained if left.patterns else 0.0
    strange = left.p < _STRANGE and pattern > _SHAPE * sum(n.best.explained for n in found.named)
    if not found.named:
        if broken and found.complete and not (lacking or strange):
            return Verdict.NAMED, tuple(reasons)
        if lacking or strange or not found.complete:
            reasons.append(
                f"Something is missing (lack of fit: F = {after.ratio:.2f}, p = {after.p:.2g}; strangest pattern: "
                f"p = {left.p:.2g}), and no known effect leaves a trace like it."
            )
            return Verdict.UNKNOWN, tuple(reasons)
        reasons.append(
            f"No candidate stands out from noise (p = {found.before.screen.p:.2g} for all of them together), "
            f"and the fit reaches the noise floor (F = {after.ratio:.2f}, p = {after.p:.2g})."
        )
        return Verdict.NOTHING, tuple(reasons)
    if not found.complete or lacking or strange:
        nearest = ", ".join(named.best.effect.label for named in found.named)
        reasons.append(
            f"Known effects come near ({nearest}), but leave something behind. With them: lack of fit F = "
            f"{after.ratio:.2f}, p = {after.p:.2g}; strangest pattern p = {left.p:.2g}."
        )
        return Verdict.UNKNOWN, tuple(reasons)
    if min(after.p, left.p) < _LACK:
        reasons.append(
            f"What is left is {100 * remainder:.1f} % of what is named: its exact shape, or a further small effect."
        )
    nearly = "nearly " if after.p < _LACK else ""
    reasons.append(
        f"With what is named the fit {nearly}reaches the noise floor (F = {after.ratio:.2f}, p = {after.p:.2g}), and "
        f"no other candidate stands out (p = {found.after.screen.p:.2g})."
    )
    ambiguous = any(named.rivals for named in found.named)
    return (Verdict.AMBIGUOUS if ambiguous else Verdict.NAMED), tuple(reasons)


def _remainder(found: Search, after: Floor) -> float:
    """What the named effects leave beyond noise, as a share of what they explain."""
    before, rest = found.before.fit, found.after.fit
    noise = after.variance if not after.provisional else 1.0
    explained = before.rss - rest.rss
    if explained <= 0:
        return np.inf
    return max(rest.rss - noise * rest.freedoms, 0.0) / explained
