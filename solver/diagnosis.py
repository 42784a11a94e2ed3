"""Whether a solve can be believed: what in the readings or the fit says that something is wrong, and what to do.

Runs after the estimate. A fit that stopped well can still be no answer: readings that the
mechanism cannot explain, a few poses that contradict all others, poses that show nothing.
Such a solve gets a status of its own (`trust_region.Status`), so that nothing downstream
takes its numbers for a result. What is merely odd is a finding with the grade "caution".

Refuses to repair: which pose or number of the rig is wrong is for a person to decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, SerialMechanism
from solver.coincidence import coaxial_joints, coincident_fixtures, contradicted_distances
from solver.estimate.estimate import Estimate
from solver.estimate.identifiability import plausible_error
from solver.estimate.nuisance import Observations, Settled
from solver.estimate.trust_region import Status
from solver.mechanism.model import Model
from solver.mechanism.serial import SerialModel
from solver.mobility import immobile, offset_determined, told
from solver.poses.wander import limits
from solver.samples import PoseTable
from solver.suspects import suspects

Array = NDArray[np.float64]

_STILL_COUNTS, _STILL_ERRORS = 3.0, 8.0  # peak to peak below both: the channel did not move
_UNEXPLAINED = 0.05  # of the root mean square motion: more is not a calibration error
_OUTLYING = 10.0  # times the usual residual of a pose
_FEW = 0.25  # of the poses: more of them are not outliers but a wrong model
_OUTLIERS_SHARE = 0.8  # of the misfit that outlying poses make
_BEYOND = np.deg2rad(3.0)  # past a limit: more is not a calibration error
_CORRELATED = 0.995
_FAR = 10.0  # stated uncertainties, and more than plausible: an answer there is another one


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that speaks against a solve.

    Attributes:
        kind: short name, for programs.
        grade: "bad" where the numbers are no result, "caution" where they need a second look.
        text: what was seen and what to do, in one or two sentences.
    """

    kind: str
    grade: Literal["bad", "caution"]
    text: str


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What speaks against a solve, and the status that follows.

    Attributes:
        status: the estimate's own, unless a finding is bad.
        findings: the bad ones first.
    """

    status: Status
    findings: tuple[Finding, ...]


def diagnose(
    rig: Rig,
    model: Model,
    table: PoseTable,
    poses: NDArray[np.intp],
    estimate: Estimate,
    settled: Settled,
    rank: int,
) -> Diagnosis:
    """The diagnosis of an estimate.

    Args:
        rig: as recorded.
        model: its mechanism.
        table: averaged readings.
        poses: those that the estimate used.
        estimate: what the method returned.
        settled: all poses of ``table`` at the estimate.
        rank: directions that the poses determine.
    """
    status = estimate.status
    broken = contradicted_distances(rig, estimate.parameters)
    if status is Status.CONVERGED and broken:
        status = Status.UNEXPLAINED
    doubled = (*coincident_fixtures(rig), *coaxial_joints(rig))
    twice = (*broken, *(c.text[:1].upper() + c.text[1:] for c in doubled if c.sure))
    stands = _stands(rig, model, still_channels(table), settled.coordinates[poses], estimate)
    found: list[Finding] = []
    if rank == 0:
        status = Status.UNDETERMINED
        found.append(
            Finding("undetermined", "bad", f"{status.value[:1].upper()}{status.value[1:]}.")
        )
    elif status is Status.CONVERGED and estimate.inflation > 1.0:
        outlying = _outlying(settled, poses)
        if len(outlying):
            status = Status.OUTLYING
            found.append(Finding("outlying-poses", "bad", _outliers(table, outlying)))
        elif _unexplained(rig, table, settled, poses, estimate.parameters) > _UNEXPLAINED:
            status = Status.UNEXPLAINED
    if status is Status.CONVERGED:
        far = _far(estimate)
        if far is not None:
            status = Status.FAR_FROM_NOMINAL
            found.append(Finding("far-from-nominal", "bad", far))
    told_already = (Status.CONVERGED, Status.OUTLYING, Status.UNDETERMINED, Status.FAR_FROM_NOMINAL)
    if status not in told_already:
        observed = Observations(table.counts, table.sigma).take(poses)
        named = (*stands, *twice) or suspects(rig, model, observed, estimate.space.nominal)
        share = _unexplained(rig, table, settled, poses, estimate.parameters)
        text = f"What the mechanism leaves unexplained is {100 * share:.3g} % of the motion. "
        found.append(Finding("unexplained", "bad", text + " ".join(named or (_UNKNOWN,))))
    elif stands:
        found += [Finding("no-motion", "caution", text) for text in stands]
    if status in told_already:
        found += [Finding("coincidence", "caution", text) for text in twice]
    if status is Status.CONVERGED:
        found += _beyond_limits(rig, model, settled.coordinates[poses]) + _correlated(estimate)
    return Diagnosis(status, tuple(found))


_UNKNOWN = (
    "No single gain, sign or exchange of channels explains it: check nominal lengths and angles, "
    "and that the recording was made with this mechanism and this fixture."
)


def still_channels(table: PoseTable) -> NDArray[np.intp]:
    """Channels that read the same at every pose."""
    spread = np.ptp(table.counts, axis=0)
    noise = _STILL_ERRORS * np.median(table.sigma, axis=0)
    return np.flatnonzero(spread <= np.maximum(_STILL_COUNTS, noise))


def _stands(
    rig: Rig, model: Model, still: NDArray[np.intp], coordinates: Array, estimate: Estimate
) -> tuple[str, ...]:
    """Why each of the channels ``still`` may have read the same at every pose."""
    if not len(still):
        return ()
    cannot: set[str] = set()
    if isinstance(model, SerialModel):
        fixed = immobile(model, estimate.parameters, coordinates)
        cannot = {model.coordinate_names[j] for j in fixed}
    out = []
    for channel in (rig.channels[c] for c in still):
        said = f"Channel {channel.name} reads the same at every pose: "
        if channel.senses in cannot:
            determined = offset_determined(
                estimate.space, estimate.held, channel.senses, channel.name
            )
            out.append(said + told(channel.senses, determined=determined))
        else:
            out.append(
                f"{said}{channel.senses} did not move, or its sensor is stuck. "
                "Move it between the poses, or check sensor and cable."
            )
    return tuple(out)


def _unexplained(
    rig: Rig, table: PoseTable, settled: Settled, poses: NDArray[np.intp], parameters: Array
) -> float:
    """Root mean square residual over root mean square motion, the larger of angles and lengths."""
    names = {channel.name: c for c, channel in enumerate(rig.channels)}
    gain = np.array([abs(channel.gain.nominal) for channel in rig.channels])
    residual = (settled.residual * table.sigma * gain)[poses]
    motion = (table.counts * gain)[poses]
    motion = motion - motion.mean(axis=0)
    shares = []
    for dimension in ("angle", "length"):
        of = [
            names[channel.name]
            for channel in rig.channels
            if rig.mechanism.dimension_of(channel.senses) == dimension
        ]
        moved = float(np.sqrt(np.sum(motion[:, of] ** 2)))
        if moved > 0:
            shares.append(float(np.sqrt(np.sum(residual[:, of] ** 2))) / moved)
    return max(shares, default=0.0)


def _outlying(settled: Settled, poses: NDArray[np.intp]) -> NDArray[np.intp]:
    """Used poses that carry the misfit while all others agree."""
    cost = np.sum(settled.residual[poses] ** 2, axis=1)
    far = cost > _OUTLYING**2 * max(float(np.median(cost)), 1.0)
    if not far.any() or far.mean() > _FEW or cost[far].sum() < _OUTLIERS_SHARE * cost.sum():
        return np.zeros(0, dtype=np.intp)
    order = np.flatnonzero(far)
    return np.asarray(poses[order[np.argsort(-cost[order], kind="stable")]])


def _outliers(table: PoseTable, outlying: NDArray[np.intp]) -> str:
    named = [f"{i}" for i in outlying[:6]]
    more = f" and {len(outlying) - 6} more" if len(outlying) > 6 else ""
    verb = "contradicts" if len(outlying) == 1 else "contradict"
    first = table.windows[int(outlying[0])]
    return (
        f"Dwell {', '.join(named)}{more} (counted from 0; the worst began at {first.start_ns} ns) {verb} all others: "
        "the mechanism slipped, hit something, changed its branch, or a sensor jumped. Leave them out, or record again."
    )


def _far(estimate: Estimate) -> str | None:
    """What to say where a parameter ends implausibly far from what the rig states; None where none does."""
    space = estimate.space
    angle = np.array([space.table[i].dimension == "angle" for i in space.identified])
    away = estimate.values - space.reduce(space.nominal)
    away = np.where(angle, away - 2 * np.pi * np.round(away / (2 * np.pi)), away)
    least = np.maximum(_FAR * space.uncertainty, plausible_error(space))
    share = np.abs(away) / least
    if not (share > 1.0).any():
        return None
    worst = int(np.argmax(share))
    parameter = space.table[space.identified[worst]]
    change, stated = away[worst] / parameter.to_si, space.uncertainty[worst] / parameter.to_si
    return (
        f"{parameter.name} ends {change:+.3g} {parameter.unit} from its nominal value, of which the rig states an "
        f"uncertainty of {stated:.3g} {parameter.unit}: the readings were fitted by another assembly of the mechanism, "
        "or by a twin of it, or the nominal value is wrong. Give offsets and homes nearer to the truth, sense "
        "more joints, or state the larger uncertainty, and solve again."
    )


def _beyond_limits(rig: Rig, model: Model, coordinates: Array) -> list[Finding]:
    if not isinstance(model, SerialModel) or not isinstance(rig.mechanism, SerialMechanism):
        return []
    low, high = limits(rig, model)
    beyond = np.maximum(low - coordinates, coordinates - high).max(axis=0)
    return [
        Finding(
            "beyond-limits",
            "caution",
            f"The solution puts {model.coordinate_names[j]} up to {np.rad2deg(beyond[j]):.3g} deg (SI {beyond[j]:.3g}) "
            "beyond its stated limits; check its zero, its sign and the limits.",
        )
        for j in np.flatnonzero(beyond > _BEYOND)
        if j in model.sensed
    ]


def _correlated(estimate: Estimate) -> list[Finding]:
    errors = np.sqrt(np.diag(estimate.covariance))
    if len(errors) < 2 or not (np.isfinite(errors).all() and (errors > 0).all()):
        return []
    correlation = np.abs(estimate.covariance / np.outer(errors, errors)) - np.eye(len(errors))
    i, j = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    if correlation[i, j] < _CORRELATED:
        return []
    names = estimate.space.names
    return [
        Finding(
            "correlated",
            "caution",
            f"{names[i]} and {names[j]} are told apart only weakly (correlation {correlation[i, j]:.4f}): "
            "trust their combined effect more than either. More varied poses, or holding one of them, help.",
        )
    ]
