"""`loopcal plan`: the plan file, and on the terminal what the session will determine."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from loopcal.console import fail, out
from loopcal.files import create
from recordings.reader import read_recording
from recordings.rig import Plan, Rig, load_rig, parameters
from solver.poses.criteria import criterion_named
from solver.poses.planning import SessionPlan, plan_session
from solver.poses.prediction import Predicted
from solver.report.notation import figures, unit_of
from solver.solve import solve

_SUGGESTED = 400  # lines of poses that a by-hand plan file lists at most


def run_plan(
    name: str, *, source: Path | None, output: Path | None, poses: int | None, criterion: str
) -> None:
    """Plan a session of a rig, show what it will determine, and write the plan file."""
    rig = load_rig(name)
    values = None if source is None else calibrated_values(rig, source)
    with out.status("planning"):
        planned = plan_session(
            rig, values=values, poses=poses, criterion=criterion_named(criterion)
        )
    _show(planned)
    if output is not None:
        create(output, plan_text(rig, planned))
        out.print(f"wrote {output}", markup=False)


def calibrated_values(rig: Rig, source: Path) -> NDArray[np.float64]:
    """(N,) parameters of ``rig`` from a result file of `loopcal solve --json`, or from a recording, SI."""
    table = parameters(rig)
    try:
        is_result = source.read_bytes()[:1] == b"{"
    except OSError as error:
        fail(f"cannot read '{source}': {error.strerror}")
    if is_result:
        try:
            document: Any = json.loads(source.read_text("utf-8"))
            found = {row["name"]: float(row["value"]) for row in document["parameters"]}
        except (ValueError, KeyError, TypeError):
            fail(f"'{source}' is not a result file; `loopcal solve FILE --json FILE` writes one")
    else:
        solved = solve(read_recording(source)).estimate
        found = {
            p.name: float(v) / p.to_si
            for p, v in zip(solved.space.table, solved.parameters, strict=True)
        }
    missing = [p.name for p in table if p.name not in found]
    if missing:
        fail(
            f"'{source}' is of another rig: it has no parameter '{missing[0]}' of rig '{rig.name}'"
        )
    return np.array([found[p.name] * p.to_si for p in table])


def plan_text(rig: Rig, planned: SessionPlan) -> str:
    """The plan file: TOML with one table, ``[plan]``."""
    plan = planned.plan
    lines = [
        f"# Planned for rig '{rig.name}': {plan.poses} poses.",
        *(f"# {line}" for line in _worst(planned)),
        "",
        *plan_lines(rig, plan, planned.coordinates, planned.coordinate_names),
    ]
    return "\n".join(lines) + "\n"


def plan_lines(
    rig: Rig, plan: Plan, coordinates: NDArray[np.float64], names: Sequence[str]
) -> list[str]:
    """The table ``[plan]``; by hand with the poses ``coordinates`` (N, U) of ``names`` as comments."""
    lines = [
        "[plan]",
        f'mode = "{plan.mode}"',
        f"sample_hz = {plan.sample:g}",
        f"poses = {plan.poses}",
        f"dwell_s = {plan.dwell:g}",
        f"settle_s = {plan.settle:g}",
        f"seed = {plan.seed}",
        f"revisit = {{ poses = {plan.revisit.poses}, visits = {plan.revisit.visits} }}",
    ]
    if plan.mode == "driven":
        turning = all(rig.mechanism.dimension_of(name) == "angle" for name in plan.drives)
        # One unit for all drives: where some slide, SI, in which both kinds have the factor 1.
        unit, factor = ("deg", np.rad2deg(1.0)) if turning else ("rad", 1.0)
        drives = ", ".join(f'"{name}"' for name in plan.drives)
        move = (
            f"move_deg_per_s = {np.rad2deg(plan.move):g}"
            if turning
            else f"move_m_per_s = {plan.move:g}"
        )
        rows = [
            "  [" + ", ".join(f"{value * factor:.4f}" for value in row) + "],"
            for row in plan.targets or ()
        ]
        lines += [move, f"drives = [{drives}]", f"targets_{unit} = [", *rows, "]"]
    else:
        for key, angle in (("tilt_deg", plan.tilt), ("swivel_deg", plan.swivel)):
            if angle is not None:
                lines.append(f"{key} = {np.rad2deg(angle):g}")
        lines += [
            "",
            "# Suggested poses, in an order of short moves:",
            *_suggestions(coordinates, names),
        ]
    return lines


def _suggestions(coordinates: NDArray[np.float64], names: Sequence[str]) -> list[str]:
    """A comment a pose: the plate's rotation vector [deg] and shift [mm] from neutral, or the joints."""
    out = []
    for number, row in enumerate(coordinates[:_SUGGESTED]):
        parts = [
            f"{name} {value * 1e3:+.0f} mm"
            if name in ("plate.x", "plate.y", "plate.z")
            else f"{name} {np.rad2deg(value):+.0f} deg"
            for name, value in zip(names, row, strict=True)
        ]
        out.append(f"# {number + 1}: {', '.join(parts)}")
    return out


def _error(planned: SessionPlan, j: int, errors: NDArray[np.float64]) -> str:
    parameter = planned.space.table[planned.space.identified[j]]
    unit = unit_of(parameter)
    return f"{figures(float(errors[j]) / unit.to_si, 2)} {unit.name}"


def _range(planned: SessionPlan, j: int, predicted: Predicted) -> str:
    return f"{_error(planned, j, predicted.low).split()[0]} to {_error(planned, j, predicted.high)}"


def _worst(planned: SessionPlan) -> list[str]:
    predicted, followed = planned.predicted, planned.followed
    if predicted is None:
        return ["So few poses leave open what more of them would determine."]
    j = predicted.worst
    said = f"Predicted standard error of the least certain parameter, {planned.space.names[j]}: "
    said += _error(planned, j, predicted.errors)
    if followed is None:
        return [f"{said}."]
    return [
        f"{said} (typically {_range(planned, j, predicted)}) at poses as a hand picks them,",
        f"{_error(planned, j, followed.errors)} at the poses suggested below.",
    ]


def _show(planned: SessionPlan) -> None:
    plan, space = planned.plan, planned.space
    driving = f", driving {' and '.join(plan.drives)}" if plan.drives else ", by hand"
    out.print(
        f"{plan.poses} poses{driving}; revisits: {plan.revisit.poses} poses, {plan.revisit.visits} visits each",
        markup=False,
    )
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("parameter")
    predicted, followed = planned.predicted, planned.followed
    table.add_column("predicted ± SE", justify="right")
    if followed is not None:
        table.add_column("typically", justify="right")
        table.add_column("at the suggested poses", justify="right")
    for j, name in enumerate(space.names):
        row = [name, "–" if predicted is None else _error(planned, j, predicted.errors)]
        if followed is not None:
            row.append("–" if predicted is None else _range(planned, j, predicted))
            row.append(_error(planned, j, followed.errors))
        table.add_row(*row)
    out.print(table)
    if predicted is None:
        out.print("so few poses leave open what more of them would determine", markup=False)
    elif followed is not None:
        out.print(
            "By hand: the median, and the range of eight sessions in ten, over random poses within reach.",
            markup=False,
            soft_wrap=True,
        )
    for words in planned.still:
        out.print(words, markup=False, soft_wrap=True)
    for words in planned.held:
        out.print(f"no pose determines: {words}", markup=False, soft_wrap=True)
    sizes = Table(
        title="How many poses do I need?",
        title_justify="left",
        box=None,
        padding=(0, 2, 0, 0),
        header_style="bold",
    )
    sizes.add_column("poses", justify="right")
    sizes.add_column("least certain")
    sizes.add_column("± SE", justify="right")
    if followed is not None:
        sizes.add_column("typically", justify="right")
    for size in planned.by_poses:
        row = [f"{size.poses}", space.names[size.worst], _error(planned, size.worst, size.errors)]
        if followed is not None:
            row.append(_range(planned, size.worst, size))
        sizes.add_row(*row)
    out.print(sizes)
