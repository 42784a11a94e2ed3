"""What speaks against an answer that a gap analysis gives: single poses, parameters that went far, poses held out.

None of them is an effect, and none is seen by a test over all poses.
"""

from __future__ import annotations

import numpy as np

from solver.estimate.identifiability import plausible_error
from solver.gap.channels import Disagreement
from solver.gap.fit import Fit
from solver.gap.floor import Floor
from solver.gap.held_out import HeldOut
from solver.samples import PoseTable

_OUTLYING = 6.0  # standard errors
_MOST = 5  # dwells that are told
_APART = 1.5  # times the noise within dwells
_SOME = 0.1  # of the dwells that may be left out without a word
_FAR = 10.0  # stated uncertainties, and more than plausible


def cautions(
    fit: Fit,
    found: Disagreement | None,
    table: PoseTable,
    gap: HeldOut | None,
    strange: Floor | None = None,
) -> tuple[str, ...]:
    """In sentences for the user.

    Args:
        fit: the final model.
        found: the disagreement with it; None where single poses are not to be told.
        table: the poses.
        gap: on held-out poses; None where there is none, or nothing is missing.
        strange: the floor, where what is missing has no name.
    """
    return (
        *_left_out(table),
        *_far(fit),
        *(_unsteady(gap) if strange is None else _in_noise(gap, strange)),
        *(() if found is None else _outlying(found, table)),
    )


def _left_out(table: PoseTable) -> tuple[str, ...]:
    gone, used = table.rejected, len(table.windows)
    if len(gone) <= _SOME * (len(gone) + used):
        return ()
    return (
        f"{len(gone)} of {len(gone) + used} dwells were left out, and what shows in them is missed (the first: "
        f"{gone[0].reason}).",
    )


def _unsteady(gap: HeldOut | None) -> tuple[str, ...]:
    if gap is None or not gap.left_open:
        return ()
    return (
        f"Looked for anew in four fifths of the poses, what is missing leaves a gap of {gap.after:.2f} (standard "
        f"error {gap.after_error:.2g}) in the fifth that took no part, where noise leaves 1: what is named depends "
        "on which poses are used.",
    )


def _in_noise(gap: HeldOut | None, floor: Floor) -> tuple[str, ...]:
    """Of what differs between visits of one pose, the gap says nothing: its unit is how they differ."""
    apart = float(np.sqrt(floor.variance))
    if gap is None or gap.opens or floor.provisional or apart < _APART:
        return ()
    return (
        f"Visits of one pose differ {apart:.1f} times as much as noise within a dwell explains. What differs from visit "
        f"to visit counts as noise, so that the gap of {gap.before:.2f}, whose unit that noise is, does not show it.",
    )


def _far(fit: Fit) -> tuple[str, ...]:
    """Of parameters that are angles, the whole turns do not count."""
    space, own = fit.space, len(fit.model.site.table)
    away = fit.parameters[space.identified] - space.reduce(space.nominal)
    angle = np.array([space.table[i].dimension == "angle" for i in space.identified])
    away = np.where(angle, away - 2.0 * np.pi * np.round(away / (2.0 * np.pi)), away)
    least = np.maximum(_FAR * space.uncertainty, plausible_error(space))
    share = np.where(space.identified < own, np.abs(away) / least, 0.0)
    if not (share > 1.0).any():
        return ()
    worst = int(np.argmax(share))
    parameter = space.table[space.identified[worst]]
    return (
        f"{parameter.name} ends {away[worst] / parameter.to_si:+.3g} {parameter.unit} from its nominal value, of "
        f"which the rig states an uncertainty of {space.uncertainty[worst] / parameter.to_si:.3g} {parameter.unit}: "
        "the nominal value is wrong, or the readings were fitted by another assembly of the mechanism. Mend the "
        "rig before you rely on this answer.",
    )


def _outlying(found: Disagreement, table: PoseTable) -> tuple[str, ...]:
    z = np.abs(found.difference / found.standard_error)
    z = np.where(np.isfinite(z), z, 0.0)
    out = []
    for dwell in np.flatnonzero(z.max(axis=1, initial=0.0) > _OUTLYING)[:_MOST]:
        window, channel = table.windows[dwell], int(z[dwell].argmax())
        out.append(
            f"Pose {window.pose}, visit {window.visit}, stands alone: {found.channels[channel]} lies "
            f"{z[dwell, channel]:.0f} standard errors from what the rest of the loop predicts."
        )
    return tuple(out)
