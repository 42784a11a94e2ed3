"""The whole way from a recording to a solution: average, select, identify, check.

Owns the order of the steps and what counts as too little data. Every step lives in a file
of its own; this one reads top to bottom like the method section of a paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from recordings.reader import Recording
from recordings.rig import Rig, parameters
from solver.closure import ClosureErrors, closure_errors
from solver.coincidence import coaxial_joints, coincident_fixtures
from solver.diagnosis import Finding, diagnose, still_channels
from solver.drives import held_joints
from solver.effects.needs import loaded, needs, require_shown
from solver.errors import MechanismError, MethodError, NotEnoughData
from solver.estimate import hinge, likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.identifiability import (
    BY_PRIORS,
    Identifiability,
    identifiability,
    plausible_error,
    undetermined,
)
from solver.estimate.locating import located
from solver.estimate.methods import Method, fitting, method_named
from solver.estimate.nuisance import Observations, Settled, assemble, settle
from solver.estimate.null_directions import point_frames
from solver.estimate.robust import Loss
from solver.estimate.trust_region import Status
from solver.mechanism.model import Model, model_of
from solver.mechanism.serial import SerialModel
from solver.mechanism.space import ParameterSpace
from solver.motion import with_motion
from solver.poses.criteria import Criterion
from solver.poses.observability import Observability, observability
from solver.poses.selection import Selection, select
from solver.samples import PoseTable, average
from solver.suspects import suspects

Array = NDArray[np.float64]

DEFAULT_POSES = 50


@dataclass(frozen=True)
class Solution:
    """What a recording says about its rig.

    Attributes:
        rig: the rig as recorded.
        model: its mechanism and sensors.
        table: averaged poses, all that are usable.
        selection: which of them were used.
        method: how.
        estimate: the result, from the selected poses.
        beside: results of the other methods that fit, from the same poses.
        identifiability: what the selected poses determine.
        raw: observability of the identification Jacobian (the method's own; for maximum
            likelihood the one by which poses are chosen), SI columns.
        scaled: the same with unit columns.
        before: every pose settled at the nominal parameters (trackers where the poses put them).
        after: every pose settled at the estimate.
        closure_before: closure errors of the selected poses at the nominal parameters, or None
            where the mechanism has no hinge.
        closure_after: at the estimate.
        findings: what speaks against the result; its status has taken account of them.
    """

    rig: Rig
    model: Model
    table: PoseTable
    selection: Selection
    method: Method
    estimate: Estimate
    beside: tuple[Estimate, ...]
    identifiability: Identifiability
    raw: Observability
    scaled: Observability
    before: Settled
    after: Settled
    closure_before: ClosureErrors | None
    closure_after: ClosureErrors | None
    findings: tuple[Finding, ...] = ()


def solve(
    recording: Recording,
    *,
    poses: int = DEFAULT_POSES,
    method: str | None = None,
    criterion: Criterion = "sigma_L",
    loss: Loss = Loss.NONE,
    use_priors: bool = False,
) -> Solution:
    """Calibrate the rig of ``recording``.

    Args:
        recording: what was captured; its rig says what is identified.
        poses: how many poses to use, the best of all.
        method: name of a method, or None for the default.
        criterion: by which poses are chosen.
        loss: how much poses that noise cannot explain count; maximum likelihood only.
        use_priors: let the rig's stated uncertainties take part; maximum likelihood only.

    Raises:
        NotEnoughData: no dwells, a silent channel, or too few poses for the parameters.
        MethodError: the method does not exist or does not fit the mechanism.
        MechanismError: the loop cannot be closed at the nominal parameters.
    """
    rig, table = recording.rig, average(recording)
    if "rate" in needs(rig):
        table, _ = with_motion(recording, table)
    return solve_table(
        rig,
        table,
        held=held_joints(recording, table.windows) if needs(rig) else None,
        poses=poses,
        method=method,
        criterion=criterion,
        loss=loss,
        use_priors=use_priors,
    )


def solve_table(
    rig: Rig,
    table: PoseTable,
    *,
    held: NDArray[np.bool_] | None = None,
    poses: int = DEFAULT_POSES,
    method: str | None = None,
    criterion: Criterion = "sigma_L",
    loss: Loss = Loss.NONE,
    use_priors: bool = False,
) -> Solution:
    """Calibrate ``rig`` from poses that are averaged already; raises as `solve` does.

    ``held`` (P, J) says which joints drives held, where effects depend on loads.
    """
    model = model_of(rig)
    chosen = method_named(method, model)
    space = ParameterSpace.of(parameters(rig))
    if not space.names:
        raise NotEnoughData(
            f"rig '{rig.name}' identifies nothing; set identify = true on the parameters to estimate"
        )
    observed = Observations(table.counts, table.sigma, table.circumstances(rig))
    if len(still_channels(table)) == len(table.channels):
        raise NotEnoughData(
            f"all {len(table.counts)} dwells are at one and the same pose: no channel moved between them. "
            "Move the mechanism between the dwells; one pose determines nothing."
        )
    nominal = located(model, space, observed, space.nominal)
    before = settle(model, observed, assemble(model, observed, nominal), nominal, space.expansion)
    if not before.closed.any():
        raise MechanismError(_does_not_close(rig, model, observed, nominal))
    light = observed
    observed = loaded(model, light, before.coordinates, nominal, held)
    require_shown(model, space, observed.at)
    if observed is not light:
        before = settle(model, observed, before.coordinates, nominal, space.expansion)
    _require_enough(table, space, before, poses)
    use_priors = use_priors or (
        chosen.name == likelihood.NAME and priors_complete(model, space, before, nominal)
    )
    identify = _optioned(chosen, loss, use_priors)

    def choose(settled: Settled, at: Array) -> Selection:
        shown = _shown(space, settled)
        return select(_judged(model, space, observed, settled, at) @ shown, poses, criterion)

    selection = choose(before, nominal)
    selected = observed.take(selection.poses)
    estimate = identify(model, space, selected)
    if estimate.status is Status.DOES_NOT_CLOSE:
        raise MechanismError(_does_not_close(rig, model, observed, nominal))
    # The first choice was made at the nominal parameters; choose again where the answer is. So were loads.
    after = settle(model, observed, before.coordinates, estimate.parameters, space.expansion)
    if after.closed.all() and (poses < len(table.counts) or observed is not light):
        observed = loaded(model, light, after.coordinates, estimate.parameters, held)
        selection = choose(after, estimate.parameters)
        selected = observed.take(selection.poses)
        estimate = identify(model, space, selected)
        after = settle(model, observed, after.coordinates, estimate.parameters, space.expansion)
    others = tuple(m.identify(model, space, selected) for m in fitting(model) if m is not chosen)
    closure = [
        closure_errors(model, space, selected, x)
        if isinstance(model, SerialModel) and hinge.fits(model)
        else None
        for x in (space.nominal, estimate.parameters)
    ]
    if chosen.name == likelihood.NAME:
        judged = _judged(model, space, observed, after, estimate.parameters)[selection.poses]
        jacobian = judged.reshape(-1, judged.shape[2])
    else:
        jacobian = estimate.jacobian
    at_selected = after.jacobian[selection.poses].reshape(-1, len(space.names))
    known = model.pseudo_observations(estimate.parameters, space.expansion)[1]
    determined = identifiability(
        space, np.vstack([at_selected, known]), estimate.parameters, point_frames(rig)
    )
    if use_priors:
        determined = replace(determined, held_by=(BY_PRIORS,) * len(determined.held_by))
    told = diagnose(rig, model, table, selection.poses, estimate, after, determined.rank)
    estimate = replace(estimate, status=told.status)
    return Solution(
        rig=rig,
        model=model,
        table=table,
        selection=selection,
        method=chosen,
        estimate=estimate,
        beside=others,
        identifiability=determined,
        raw=observability(jacobian, scaled=False),
        scaled=observability(jacobian, scaled=True),
        before=before,
        after=after,
        closure_before=closure[0],
        closure_after=closure[1],
        findings=told.findings,
    )


def _optioned(
    method: Method, loss: Loss, use_priors: bool
) -> Callable[[Model, ParameterSpace, Observations], Estimate]:
    """The method with what only maximum likelihood can take account of."""
    if method.name == likelihood.NAME:
        return partial(likelihood.identify, loss=loss, use_priors=use_priors)
    if loss is not Loss.NONE or use_priors:
        raise MethodError(
            f"a robust loss and priors need the method '{likelihood.NAME}', not '{method.name}', "
            "which weighs all poses alike"
        )
    return method.identify


def priors_complete(model: Model, space: ParameterSpace, settled: Settled, at: Array) -> bool:
    """Whether the data leave directions open that the rig's stated uncertainties close."""
    known = model.pseudo_observations(at, space.expansion)[1]
    data = np.vstack([settled.jacobian.reshape(-1, len(space.names)), known])
    stated = np.isfinite(space.uncertainty)
    believed = np.eye(len(stated))[stated] / space.uncertainty[stated, None]
    return bool(
        undetermined(space, data)[0].shape[1]
        and not undetermined(space, np.vstack([data, believed]))[0].shape[1]
    )


def _shown(space: ParameterSpace, settled: Settled) -> Array:
    """(n, n - k) directions that all poses together determine: others would spoil every choice."""
    hidden = undetermined(space, settled.jacobian.reshape(-1, len(space.names)))[0]
    if not hidden.shape[1]:
        return np.eye(len(space.names))
    basis = np.linalg.qr(hidden, mode="complete")[0][:, hidden.shape[1] :]
    return np.asarray(plausible_error(space)[:, None] * basis)


def _judged(
    model: Model, space: ParameterSpace, observed: Observations, settled: Settled, at: Array
) -> Array:
    """(P, E, n) Jacobian by which poses are chosen and observability is judged.

    For a hinged arm that of the closure errors, as in the paper: comparable with its figures,
    and it does not stake the choice of poses on the stated noise of each sensor. Otherwise
    the whitened one of the likelihood.
    """
    if isinstance(model, SerialModel) and hinge.fits(model):
        return hinge.residual(model, observed.counts, at, space.expansion).closure.by_parameters
    return settled.jacobian


def _does_not_close(rig: Rig, model: Model, observed: Observations, nominal: Array) -> str:
    twice = (*coaxial_joints(rig), *coincident_fixtures(rig))
    told = tuple(c.text for c in twice if c.sure or c.contradicted)
    told = told or suspects(rig, model, observed, nominal)
    told = told or (
        "Check lengths, angles, the signs of gains and the order of the channels; `loopcal rig check` shows the mechanism.",
    )
    return (
        f"the mechanism of rig '{rig.name}' does not close at its nominal parameters with these readings. "
        f"{told[0]}"
    )


def _require_enough(table: PoseTable, space: ParameterSpace, before: Settled, poses: int) -> None:
    unknowns, usable = len(space.names), len(table.counts)
    if poses < 1:
        raise NotEnoughData(f"{poses} poses were asked for, expected at least 1")
    equations = _redundancy(before)
    needed = int(np.ceil((unknowns + 1) / max(equations, 1)))
    if min(usable, poses) < needed:
        dropped = f" ({len(table.rejected)} dwells were rejected)" if table.rejected else ""
        raise NotEnoughData(
            f"{min(usable, poses)} usable poses{dropped} for {unknowns} unknowns, expected at least {needed}: "
            f"each pose gives {equations} equations. Record more poses, or identify fewer parameters."
        )


def _redundancy(settled: Settled) -> int:
    """Equations a pose contributes: rank of what its residual can show."""
    singular = np.linalg.svd(settled.jacobian[: min(20, len(settled.jacobian))], compute_uv=False)
    return int(np.median((singular > 1e-8 * singular[:, :1]).sum(axis=1)))
